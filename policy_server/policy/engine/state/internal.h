// What RobotState keeps for the evaluator alone.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_INTERNAL_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_INTERNAL_H_

#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "policy_server/policy/engine/state/count_windows.h"
#include "policy_server/policy/engine/state/event.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/policy/engine/state/topic_cache.h"
#include "policy_server/policy/engine/state/trace.h"

namespace rips::engine {

// A chain that waits for the robot.
struct ParkedChain {
  // The rules it belongs to, which may no longer be in force.
  std::shared_ptr<const CompiledPolicy> program;
  uint32_t rule = 0;
  uint32_t chain = 0;
  // The action it waits for.
  size_t action = 0;
  // The event that started it; its views are of the strings before it.
  std::string topic;
  std::string type;
  std::string sender;
  std::vector<Verdict> inspections;
  Event event;
  int64_t time_ns = 0;
  int64_t deadline_ns = 0;
  // exec: the run; trigger: 0.
  uint64_t run_id = 0;
  // trigger: the level asked for, in the table in force, and the way there.
  levels::LevelIndex wants = 0;
  bool lowering = false;
  // Why its rule fired; may be null.
  SharedTrace trace;
  // Variables of `program` as they were when it was replaced; null while it is in force.
  std::shared_ptr<const std::vector<lang::Value>> left_behind;
};

// A program under way on the robot.
struct ProgramRun {
  std::string program;
  std::vector<std::string> args;
  int64_t deadline_ns = 0;
};

// The last refusal of one rule and level.
struct RefusalRecord {
  levels::LevelIndex from = 0;
  levels::Refusal reason = levels::Refusal::kNone;
  // Two stays at one level are not the same `from`.
  DecisionId based_on;
  uint64_t count = 0;
};

// How often a rule was traced in a second of `Time`.
struct TraceCount {
  static constexpr uint32_t kMax = 128;

  int64_t second = 0;
  uint32_t traces = 0;
};

struct RobotState::Internal {
  StateLimits limits;
  Instant started;
  // By index of the program in force.
  std::vector<lang::Value> values;
  // The highest `Time` so far.
  int64_t time_ns = std::numeric_limits<int64_t>::min();
  TopicCache topics;
  // message_counts.h: by topic, and by topic and writer.
  CountWindows counts;
  // Lost by topic, of writers that are not known.
  CountWindows lost_by_anybody;
  // Lost of nobody knows which topic; one key, which nobody can push out.
  CountWindows lost_anywhere;
  // In the order they were parked.
  std::vector<std::unique_ptr<ParkedChain>> parked;
  absl::btree_map<uint64_t, ProgramRun> runs;
  uint64_t last_run_id = 0;
  // By rule name; `Time` of the last alert about a fault.
  absl::flat_hash_map<std::string, int64_t> fault_alerted_ns;
  std::optional<int64_t> full_alerted_ns;
  // By rule name.
  absl::flat_hash_map<std::string, TraceCount> traces;
  absl::flat_hash_set<std::string> cut_rules;
  absl::flat_hash_map<std::pair<std::string, levels::LevelIndex>, RefusalRecord> refusals;
  absl::btree_map<levels::LevelIndex, LevelRequests> level_requests;
};

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_INTERNAL_H_
