// Replayer: runs rules on recorded events, as the policy server would have run them on the robot's.
//
// What differs from a live robot:
//   - Time is that of the events; no clock is read. An event without one happens `event_interval`
//     after the one before it, the first at 0. Of times that go back, the latest so far counts.
//     `Uptime` counts from the first event, on from `uptime_ns`.
//   - Programs and levels have their answer at once, as the options say, so that a chain has ended
//     before the next begins. Evidence is complete and nothing is late unless said otherwise, here
//     or by the recording, and each refused transition is recorded.
//   - Messages before the recording began are in no count.
//   - A graph that is not settled is not judged, as on the server; its changes are collected until
//     it is. If the recording knows no graph, questions about it are undecidable.
//   - The sender of a message is the recorded one; without, it is found in the graph.
//   - Once a rule calls `crash`, events are counted and not judged.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_REPLAYER_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_REPLAYER_H_

#include <array>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/flat_hash_set.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/policy/inspect/inspection_set.h"
#include "policy_server/policy/recording/reader.h"
#include "policy_server/policy/replay/result.h"
#include "services/base/clock.h"

namespace rips::replay {

// Times of events, nanoseconds since the Unix epoch: 0 to this (the year 2116), inclusive.
inline constexpr int64_t kTimeNsMax = int64_t{1} << 62;
// In the place of a rule's name, where an operator changed the level.
inline constexpr char kOperatorName[] = "operator";
// Virtual ticks between two events.
inline constexpr int64_t kTicksBetweenEventsMax = 1'000'000;

struct ReplayOptions {
  // In the program's table.
  levels::LevelIndex start_level = 0;
  // `Robot`.
  std::string robot;
  // `Uptime` at the first event.
  int64_t uptime_ns = 0;
  // Programs whose every run fails, and levels that the robot never reaches.
  absl::flat_hash_set<std::string> failing_programs;
  absl::flat_hash_set<levels::LevelIndex> failing_levels;
  // Runs `rules External` on a tick every so often, from the first event to the last; 0: never. A
  // tick at the time of an event comes first.
  int64_t tick_ns = 0;
  // At least 0.
  int64_t event_interval_ns = kNanosPerMilli;
  bool graph_known = true;
  // Measures rules. Not owned; outlives the replayer. Null: RuleHits::total_ns stays 0, and the
  // same events give an equal result.
  const Clock* profile_clock = nullptr;
  // Entries of all lists of the result together; more are counted only.
  size_t records_max = 1'000'000;
};

// Not thread-safe.
class Replayer {
 public:
  // `session` is of the program's inspections. Not owned, outlives this; null: none is made, and
  // rules that ask for one find it unscanned.
  Replayer(std::shared_ptr<const engine::CompiledPolicy> program, ReplayOptions options,
           inspect::Session* session);
  ~Replayer();
  Replayer(const Replayer&) = delete;
  Replayer& operator=(const Replayer&) = delete;

  // Variables that differ from the program's initial ones; before the first event. As
  // RobotState::RestoreVariables.
  void SetVariables(const absl::btree_map<std::string, lang::Value>& values);

  // The next event. InvalidArgument: its time is out of range, or its change does not fit the graph
  // so far. ResourceExhausted: too many ticks since the event before. The message names the event;
  // the replayer is of no more use then, unless the next graph is whole.
  absl::Status Judge(const recording::Recorded& event);
  // A tick at `time_ns`, which is of event `event`. Times are up to kTimeNsMax.
  void JudgeTick(uint64_t event, int64_t time_ns);
  // An operator, who sees the current decision, raises or lowers the level. A transition of
  // kOperatorName; no rule runs on it.
  void Order(uint64_t event, int64_t time_ns, bool raise, levels::LevelIndex to);
  // Not known at first.
  void SetFindings(engine::StandingFindings findings) { state_.findings = findings; }
  // Complete at first. While it is not, soft lowerings are refused as blind.
  void SetEvidence(bool complete);

  // The lists so far, which are empty afterwards and have room again; all counts go on, `left_out`
  // too.
  Records TakeRecords();
  // Name of the rule that called `crash`; empty = none has.
  std::string crashed_rule() const;
  // The lists and counts so far; `level` and `variables` are not set.
  const Result& so_far() const { return result_; }
  std::string level() const;
  absl::btree_map<std::string, lang::Value> variables() const { return state_.Variables(); }
  // All of it.
  Result Finish() const;

 private:
  class Script;
  class Observer;
  struct Times {
    // Of events.
    std::optional<int64_t> first_ns;
    int64_t last_ns = 0;
    int64_t next_tick_ns = 0;
    // Since the first event; never goes back.
    int64_t elapsed_ns = 0;
    // Of the event that is judged.
    levels::Lateness lateness = levels::Lateness::kTimely;
  };

  absl::Status TicksUntil(int64_t time_ns);
  absl::Status TakeGraph(const recording::RecordedGraph& graph);
  absl::Status JudgeGraph(const recording::RecordedGraph& graph);
  void JudgeMessage(const recording::RecordedMessage& message);
  void JudgeExternal(engine::ExternalEvent external);
  void SetLevel(const recording::RecordedLevel& level);
  void Run(const engine::Event& event);
  void Inspect(const recording::RecordedMessage& message, engine::Event& event,
               std::vector<engine::Verdict>& verdicts);
  void Take(const engine::Outcome& outcome);
  void Take(const levels::Transition& transition);
  void SetTime(uint64_t event, int64_t time_ns);
  // Sets how often each rule was evaluated.
  void CountEvaluated(Result& result) const;
  // Adds to a list of the result, if there is room.
  template <typename Record>
  void Keep(std::vector<Record>& list, Record record);

  const std::shared_ptr<const engine::CompiledPolicy> program_;
  const ReplayOptions options_;
  inspect::Session* const session_;  // Not owned; outlives this.
  std::unique_ptr<Script> script_;
  std::unique_ptr<Observer> observer_;
  engine::RobotState state_;
  Result result_;
  // What is known of the graph, which is judged once it is settled.
  // The recording says itself what was left out.
  ros2::RosGraph graph_{ros2::kWideGraphLimits};
  bool settled_ = false;

  Moment now_;
  Times times_;
  // Events that were judged, by class.
  std::array<uint64_t, lang::kEventClassCount> judged_ = {};
  // The rule that called `crash`.
  std::optional<uint32_t> crashed_rule_;
};

// Replays all of `reader`. Whether the graph is known, variables and `Uptime` at the start, and the
// robot if the options name none, come from it. Where the reader finds the recording cut or damaged
// after at least one event, the replay ends, and Result::missing says so. Other errors of the
// reader, and of Replayer::Judge.
absl::StatusOr<Result> Replay(recording::Reader& reader,
                              std::shared_ptr<const engine::CompiledPolicy> program,
                              ReplayOptions options, inspect::Session* session);

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_REPLAYER_H_
