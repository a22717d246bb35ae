// Everything that rules of one robot remember and see. Owned by one shard; not thread-safe.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_ROBOT_STATE_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_ROBOT_STATE_H_

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "policy_server/policy/engine/state/standing_findings.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/policy/levels/level_machine.h"
#include "services/ros2/ros_graph.h"

namespace rips::engine {

// What the actuators have reported of the current decision.
enum class Actuation {
  kNoLease,   // nobody obeys: trigger is false at once
  kPending,   // under way: trigger waits
  kVerified,  // read back from the robot
  kFailed,    // reported as failed: trigger is false
};

struct StateLimits {
  // Chains waiting for the robot; also programs under way.
  size_t parked_max = 64;
  int64_t chain_deadline_ns = 25 * kNanosPerSecond;
  int64_t program_deadline_ns = 10 * kNanosPerSecond;
  // Code points of a string value; longer is cut, with a warning counted once per rule.
  size_t string_max = 4'096;
};

// Why a rule came out unscanned that asked for what was left out of the graph.
inline constexpr char kGraphTruncated[] = "graph truncated";

// Told of every rule that is run, after it; for those who measure and those who replay.
class RuleObserver {
 public:
  enum class RuleResult {
    kFalse,
    kFired,
    kFaulted,
    kUndecidable,
    // It depends on an inspection that was not told, or on what was left out of the graph: it did
    // not fire; it fired all the same.
    kUnscanned,
    kFiredUnscanned,
  };
  virtual ~RuleObserver() = default;
  // `rule` is an index of the program in force. `what` says why it faulted, or is kGraphTruncated;
  // else it is empty.
  virtual void OnRule(uint32_t rule, RuleResult came, absl::string_view what) = 0;
};

// Answers for the robot at once, where there is none: in a replay. No chain waits then.
class ScriptedRobot {
 public:
  virtual ~ScriptedRobot() = default;
  // The program exits 0 in time.
  virtual bool RunProgram(absl::string_view program, const std::vector<std::string>& args) = 0;
  // The robot reaches `level`, which has been decided, and holds it.
  virtual bool Reach(levels::LevelIndex level) = 0;
};

// The graph that rules are judged against, and which one it is.
class CurrentGraph {
 public:
  // A graph as it was at one time. Two of one revision are the same.
  struct Version {
    std::shared_ptr<const ros2::RosGraph> graph;
    uint64_t revision = 0;
  };

  CurrentGraph& operator=(ros2::RosGraph graph) {
    version_ = {std::make_shared<const ros2::RosGraph>(std::move(graph)), ++newest_};
    return *this;
  }
  const ros2::RosGraph& get() const { return *version_.graph; }
  const ros2::RosGraph* operator->() const { return version_.graph.get(); }
  // Changes whenever the graph does.
  uint64_t revision() const { return version_.revision; }

  const Version& version() const { return version_; }
  // An earlier one takes its place until the newest is shown again; for an event of that time.
  void Show(Version version) { version_ = std::move(version); }

 private:
  Version version_ = {std::make_shared<const ros2::RosGraph>(), 1};
  uint64_t newest_ = 1;
};

// How often rules have asked for a level, and which rule did last.
struct LevelRequests {
  uint64_t count = 0;
  std::string rule;

  friend bool operator==(const LevelRequests&, const LevelRequests&) = default;
};

class RobotState {
 public:
  // `level` must have the program's table. `started` is when this process began judging the robot
  // (`Uptime`).
  RobotState(std::shared_ptr<const CompiledPolicy> program, levels::LevelMachine level,
             Instant started, StateLimits limits = {});
  ~RobotState();
  RobotState(RobotState&&) noexcept;
  RobotState& operator=(RobotState&&) noexcept;

  // Seen by rules. The caller keeps them up to date between events.
  CurrentGraph graph;
  // False: nothing is known of the graph, and questions about it are not decided.
  bool graph_known = true;
  // Of the robot's sensors, of any time.
  StandingFindings findings;
  levels::Evidence evidence;
  Actuation actuation = Actuation::kNoLease;
  levels::LevelMachine level;

  const std::shared_ptr<const CompiledPolicy>& program() const { return program_; }
  const Instant& started() const;

  // A rule has called `crash`: none runs, and no chain goes on, until an operator resumes them.
  bool halted() const { return halted_; }
  void Halt() { halted_ = true; }
  void Resume() { halted_ = false; }

  // `Robot`.
  std::string robot_id;

  // Not owned; may be null.
  RuleObserver* observer = nullptr;
  // Not owned; null: results come through the evaluator's functions. Otherwise `actuation` does not
  // matter, and a RunProgramEffect tells what was run and has had its answer.
  ScriptedRobot* scripted = nullptr;

  // Since the policy is in force. Also requests without effect, as for the level of the robot.
  const absl::btree_map<levels::LevelIndex, LevelRequests>& level_requests() const;

  // By name; for checkpoints and tests.
  absl::btree_map<std::string, lang::Value> Variables() const;
  // Takes what fits by name and type (and, for a variable handed to trigger, is a level), ignores
  // the rest.
  void RestoreVariables(const absl::btree_map<std::string, lang::Value>& values);

  // Another policy, between two events: variables survive by name and type, the level by name, and
  // so does the level in a variable handed to trigger. Parked chains finish under the old one: a
  // variable that is gone keeps its last value for them and setting it does nothing.
  // FailedPrecondition (nothing changes) if the new one lacks the current level.
  absl::Status SwapProgram(std::shared_ptr<const CompiledPolicy> program);

  // For the evaluator only.
  struct Internal;
  Internal& internal() { return *internal_; }
  const Internal& internal() const { return *internal_; }

 private:
  std::shared_ptr<const CompiledPolicy> program_;
  bool halted_ = false;
  std::unique_ptr<Internal> internal_;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_ROBOT_STATE_H_
