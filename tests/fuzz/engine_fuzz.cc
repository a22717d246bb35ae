// For any rules that the checker lets through, and any events: no fault is the evaluator's own
// ("internal"), no event visits a node twice, inspections that are asked for suffice, and the same
// events give the same effects: played again, and with everything that is remembered of topics and
// graph forgotten after each event.
//
// Input: a rule file, a zero byte, then a byte or two for each event.
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/policy/engine/state/compiled.h"
#include "policy_server/policy/lang/check/compile.h"
#include "services/base/check.h"

namespace {

using namespace rips;  // One translation unit, nothing else in it.
using namespace rips::engine;

ros2::RosGraph MakeGraph(size_t nodes) {
  ros2::GraphDelta delta;
  for (size_t i = 0; i < nodes; ++i) {
    ros2::Guid participant;
    participant.bytes = {1, static_cast<uint8_t>(i), 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1};
    ros2::Guid writer = participant;
    writer.bytes[14] = 1;
    writer.bytes[15] = 3;
    const std::string name = std::vector<std::string>{"/a", "/b", "/x/a", "/navigator"}[i % 4];
    delta.upsert_participants.push_back({.guid = participant});
    delta.upsert_nodes.push_back({.full_name = name, .participant = participant});
    delta.upsert_endpoints.push_back({.guid = writer,
                                      .kind = static_cast<ros2::EndpointKind>(i % 3),
                                      .name = i % 2 == 0 ? "/a" : "/cmd_vel",
                                      .type = "std_msgs/msg/String",
                                      .node = name});
  }
  ros2::RosGraph graph;
  RIPS_CHECK(graph.Apply(delta).ok(), "the graph is sound");
  return graph;
}

// Reads choices from the input; 0 when it is used up.
class Choices {
 public:
  Choices(const uint8_t* data, size_t size) : data_(data), size_(size) {}
  bool empty() const { return at_ >= size_; }
  size_t Pick(size_t n) { return empty() ? 0 : data_[at_++] % n; }

 private:
  const uint8_t* data_;
  size_t size_;
  size_t at_ = 0;
};

class Player {
 public:
  Player(std::shared_ptr<const CompiledPolicy> program, bool forget)
      : program_(std::move(program)),
        forget_(forget),
        state_(program_, levels::LevelMachine(program_->rules().levels, 0, {1, 1}, 1), now_) {
    state_.robot_id = "r1";
  }

  // What came of it, a line an effect.
  std::vector<std::string> Play(Choices choices) {
    for (int i = 0; i < 200 && !choices.empty(); ++i) {
      const auto passed = static_cast<int64_t>(choices.Pick(250)) * kNanosPerMilli;
      now_.boottime_ns += passed;
      now_.unix_ns += passed;
      Step(choices);
      if (forget_) RIPS_CHECK(state_.SwapProgram(program_).ok(), "the same program fits");
    }
    return std::move(log_);
  }

 private:
  void Step(Choices& choices) {
    switch (choices.Pick(8)) {
      case 0:
        state_.graph = MakeGraph(choices.Pick(6));
        state_.graph_known = choices.Pick(8) != 0;
        return Judge(GraphEvent{}, choices);
      case 1:
        return External(choices);
      case 2:
        return Note(OnProgramResult(choices.Pick(20), choices.Pick(2) == 0, now_, state_), false);
      case 3:
        state_.actuation = static_cast<Actuation>(choices.Pick(4));
        return Note(OnActuation(now_, state_), false);
      case 4:
        Note(Expire(now_, state_), false);
        if (state_.halted()) state_.Resume();
        state_.findings = StandingFindings(/*told_all=*/choices.Pick(2) == 0);
        if (choices.Pick(2) == 0) state_.findings.Add("impostor");
        return;
      default:
        return Message(choices);
    }
  }

  void External(Choices& choices) {
    static_assert(std::variant_size_v<ExternalEvent> == 6);
    switch (choices.Pick(6)) {
      case 0:
        return Judge(ExternalEvent(std::in_place_type<model::IdsAlert>,
                                   model::IdsAlert{.gid = 1, .sid = 7, .message = "scan"}),
                     choices);
      case 1:
        return Judge(
            ExternalEvent(std::in_place_type<model::SignalSeen>, model::SignalSeen{"SIGUSR1"}),
            choices);
      case 2:
        return Judge(ExternalEvent(std::in_place_type<AgentEvent>, AgentEvent{"sensor", "lost"}),
                     choices);
      case 3:
        return Judge(ExternalEvent(std::in_place_type<model::Finding>, model::Finding{"impostor"}),
                     choices);
      case 4:
        return Judge(ExternalEvent(std::in_place_type<model::Loss>, model::Loss{3}), choices);
      default:
        return Judge(ExternalEvent(std::in_place_type<TickEvent>), choices);
    }
  }

  void Message(Choices& choices) {
    const absl::string_view topics[] = {"/a", "/cmd_vel", "/camera", "/b"};
    const absl::string_view types[] = {"std_msgs/msg/String", "sensor_msgs/msg/Image", ""};
    const absl::string_view senders[] = {"/a", "/x/a", ""};
    MessageEvent message{.topic = topics[choices.Pick(4)],
                         .type = types[choices.Pick(3)],
                         .sender = senders[choices.Pick(3)],
                         .size_bytes = static_cast<uint32_t>(choices.Pick(200))};
    message.writer.bytes[0] = static_cast<uint8_t>(choices.Pick(3));
    Event event{.time_unix_ns = now_.unix_ns};
    event.what = message;
    const std::vector<uint32_t> needed = NeededInspections(event, now_, state_);
    // Those that were not asked for would fire rules, were they looked at after all.
    std::vector<Verdict> verdicts(program_->rules().inspections.size(), Verdict::kUnscanned);
    const bool unscanned = choices.Pick(4) == 0;
    for (const uint32_t index : needed) {
      if (!unscanned) verdicts[index] = choices.Pick(2) == 0 ? Verdict::kNo : Verdict::kYes;
    }
    std::get<MessageEvent>(event.what).inspections = verdicts;
    const Outcome outcome = Evaluate(event, now_, state_);
    RIPS_CHECK(unscanned || !state_.graph_known || outcome.unscanned == 0,
               "what a rule looked at was not asked for");
    Note(outcome, true);
  }

  template <typename What>
  void Judge(const What& what, Choices& choices) {
    Event event{
        .time_unix_ns = now_.unix_ns,
        .lateness = choices.Pick(5) == 0 ? levels::Lateness::kLate : levels::Lateness::kTimely};
    event.what.emplace<What>(what);
    Note(Evaluate(event, now_, state_), true);
  }

  // `judged`: one event, in one call.
  void Note(const Outcome& outcome, bool judged) {
    RIPS_CHECK(!judged || outcome.steps <= program_->compiled().code.size(),
               "a node was visited twice");
    for (const Effect& effect : outcome.effects) {
      if (const auto* alert = std::get_if<AlertEffect>(&effect)) {
        RIPS_CHECK(!absl::StrContains(alert->text, ": internal: "), "an internal fault");
        // A fault is told once a second, and again after what is known was forgotten.
        if (absl::StartsWith(alert->text, "fault in rule ")) continue;
        log_.push_back(absl::StrCat("alert ", alert->rule, " ", alert->text));
      } else if (const auto* change = std::get_if<TransitionEffect>(&effect)) {
        log_.push_back(absl::StrCat("level ", change->transition.to, " ",
                                    ToString(change->transition.decision_id), " ",
                                    change->transition.refused()));
      } else if (const auto* run = std::get_if<RunProgramEffect>(&effect)) {
        log_.push_back(absl::StrCat("run ", run->program, " ", run->args.size()));
      } else if (const auto* shown = std::get_if<LogEffect>(&effect)) {
        log_.push_back(absl::StrCat("log ", shown->text));
      }
    }
    log_.push_back(absl::StrCat(outcome.fired, " ", outcome.faults, " ", outcome.undecidable, " ",
                                outcome.unscanned, " ", outcome.crashed));
  }

  Instant now_{.boottime_ns = kNanosPerSecond, .unix_ns = 1'700'000'000 * kNanosPerSecond};
  std::shared_ptr<const CompiledPolicy> program_;
  bool forget_;
  RobotState state_;
  std::vector<std::string> log_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  if (size > 20'000) return 0;
  size_t rules_size = 0;
  while (rules_size < size && data[rules_size] != 0) ++rules_size;
  const std::string text(reinterpret_cast<const char*>(data), rules_size);
  const Choices choices(data + rules_size + (rules_size < size ? 1 : 0),
                        size - rules_size - (rules_size < size ? 1 : 0));
  const lang::CompileResult compiled = lang::Compile({{.path = "fuzz.rul", .text = text}});
  if (!compiled.rules) return 0;
  // Without levels or rules there is nothing to run.
  if (compiled.rules->levels.size() == 0) return 0;
  const auto program = CompiledPolicy::Create(*compiled.rules);
  RIPS_CHECK(program.ok(), "the checker let it through, the engine did not");
  const std::vector<std::string> first = Player(*program, false).Play(choices);
  RIPS_CHECK(first == Player(*program, false).Play(choices), "played again, it went another way");
  RIPS_CHECK(first == Player(*program, true).Play(choices), "what is remembered changed something");
  return 0;
}
