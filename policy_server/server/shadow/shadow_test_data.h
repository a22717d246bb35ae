// Policies and events for tests of shadows. Test code only.
#ifndef RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_TEST_DATA_H_
#define RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_TEST_DATA_H_

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/server/shadow/shadow_run.h"
#include "services/base/check.h"
#include "services/base/status_matchers.h"

namespace rips::shadow {

using pipeline::JudgedEvent;
using pipeline::RulesState;

inline constexpr char kLevels[] = "levels: DEFAULT; ALERT soft; COMPROMISED; HALT;\n";
inline constexpr char kHatch[] =
    "\nrules External: hatch: false ? trigger(DEFAULT), trigger(ALERT), trigger(COMPROMISED), "
    "trigger(HALT);\n";

inline std::shared_ptr<const engine::CompiledPolicy> ProgramOf(const std::string& text) {
  const std::vector<lang::SourceFile> files = {{.path = "t.rul", .text = text}};
  lang::CompileResult compiled = lang::Compile(files);
  RIPS_CHECK(compiled.rules.has_value(), lang::RenderText(files, compiled.diagnostics).c_str());
  return *engine::CompiledPolicy::Create(*std::move(compiled.rules));
}

// Rules after kLevels.
inline ShadowPolicy PolicyFrom(const std::string& rules, const engine::PayloadLimits& limits = {},
                               const std::string& levels = kLevels) {
  ShadowPolicy policy{.bundle_id = "sha256:1", .name = "candidate"};
  policy.program = ProgramOf(absl::StrCat(levels, rules, levels == kLevels ? kHatch : ""));
  policy.watched = MakeWatched(*policy.program, limits);
  return policy;
}

// Every inspection is answered by `answer`.
class FakeInspections final : public inspect::InspectionSet {
 public:
  using Answer = std::function<engine::Verdict(const inspect::Message&)>;
  explicit FakeInspections(Answer answer) : answer_(std::move(answer)) {}
  size_t size() const override { return 1; }
  std::unique_ptr<inspect::Session> NewSession() const override {
    return std::make_unique<FakeSession>(answer_);
  }

 private:
  class FakeSession final : public inspect::Session {
   public:
    explicit FakeSession(Answer answer) : answer_(std::move(answer)) {}
    engine::Verdict Inspect(uint32_t, const inspect::Message& message) override {
      return answer_(message);
    }

   private:
    const Answer answer_;
  };
  const Answer answer_;
};

inline std::shared_ptr<const ros2::RosGraph> GraphOf(const std::vector<std::string>& nodes) {
  auto graph = std::make_shared<ros2::RosGraph>();
  ros2::GraphDelta delta;
  uint8_t number = 1;
  for (const std::string& node : nodes) {
    ros2::Guid guid;
    guid.bytes[0] = number++;
    delta.upsert_participants.push_back({.guid = guid.Participant()});
    delta.upsert_nodes.push_back({.full_name = node, .participant = guid.Participant()});
  }
  EXPECT_THAT(graph->Apply(delta), IsOk());
  return graph;
}

inline RulesState StateOf(std::shared_ptr<const ros2::RosGraph> graph,
                          const std::string& level = "DEFAULT") {
  return {.bundle_id = "sha256:0", .level = level, .graph = std::move(graph), .settled = true};
}

// A message that views what it keeps alive, as a robot gives it.
inline JudgedEvent MessageOn(const std::string& topic, std::shared_ptr<const ros2::RosGraph> graph,
                             int64_t time_ns = 1'000, const std::string& payload = "",
                             const std::string& sender = "/camera") {
  auto names = std::make_shared<std::vector<std::string>>(
      std::vector<std::string>{topic, "std_msgs/msg/String", sender});
  pipeline::MessageSeen seen{.topic = (*names)[0],
                             .type = (*names)[1],
                             .sender = (*names)[2],
                             .size_bytes = static_cast<uint32_t>(payload.size()),
                             .payload = payload};
  auto batch = std::make_shared<pipeline::Batch>();
  batch->observations.push_back({.what = seen});
  batch->bytes = 100;
  batch->payload_bytes = payload.size();
  batch->names = names;
  JudgedEvent judged{.event = {.time_unix_ns = time_ns},
                     .graph = std::move(graph),
                     .message = &std::get<pipeline::MessageSeen>(batch->observations[0].what),
                     .batch = batch};
  judged.event.what = engine::MessageEvent{.topic = judged.message->topic,
                                           .type = judged.message->type,
                                           .sender = judged.message->sender,
                                           .size_bytes = judged.message->size_bytes};
  return judged;
}
template <typename What>
JudgedEvent EventOf(What what, std::shared_ptr<const ros2::RosGraph> graph, int64_t time_ns = 1) {
  JudgedEvent judged{.event = {.time_unix_ns = time_ns}, .graph = std::move(graph)};
  judged.event.what = std::move(what);
  return judged;
}
inline JudgedEvent TickAt(std::shared_ptr<const ros2::RosGraph> graph, int64_t time_ns = 1) {
  return EventOf(engine::ExternalEvent(engine::TickEvent{}), std::move(graph), time_ns);
}
inline JudgedEvent GraphEventOf(std::shared_ptr<const ros2::RosGraph> graph) {
  return EventOf(engine::GraphEvent{}, std::move(graph));
}

// Waits until `done`; false if it does not come true within 20 s.
inline bool Eventually(const std::function<bool()>& done) {
  for (int i = 0; i < 10'000; ++i) {
    if (done()) return true;
    absl::SleepFor(absl::Milliseconds(2));
  }
  return false;
}

}  // namespace rips::shadow

#endif  // RIPS_POLICY_SERVER_SERVER_SHADOW_SHADOW_TEST_DATA_H_
