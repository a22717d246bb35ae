// What a robot's rules were given to judge, for those who record it.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_JUDGED_EVENT_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_JUDGED_EVENT_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/container/btree_map.h"
#include "policy_server/policy/engine/state/effect.h"
#include "policy_server/policy/engine/state/event.h"
#include "policy_server/policy/engine/state/standing_findings.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/server/robot/model/inbound.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

struct JudgedEvent {
  engine::Event event;
  // The one that the event is judged against. An event may be judged against an earlier one than
  // the event before.
  std::shared_ptr<const ros2::RosGraph> graph;
  // What a MessageEvent was made of, else null.
  const MessageSeen* message = nullptr;
  // Keeps alive what event and message view, together with `graph`. Null of a message: it is the
  // batch of the message before it (action::RecordEvent).
  std::shared_ptr<const Batch> batch;
  // RIPS saw less than all of the robot.
  bool blind = false;
  engine::StandingFindings findings = {};
  // Of a message's payload the rules in force were given so many first bytes at most.
  size_t payload_bytes_max = SIZE_MAX;
  // The rules in force were not given it: only a policy that runs muted asked for it.
  bool muted = false;
};

// What rules did, and faults in them.
struct RuleCounts {
  uint64_t alerts = 0;
  // Decisions of rules, `crash` among them.
  uint64_t raises = 0;
  uint64_t lowerings = 0;
  // Refused transitions, each time.
  uint64_t refusals = 0;
  uint64_t programs = 0;
  // Rules that faulted on an event.
  uint64_t faults = 0;

  friend bool operator==(const RuleCounts&, const RuleCounts&) = default;
};

// What the rules in force did on an event, or on an answer of the robot.
struct RuleOutcome {
  RuleCounts counts;
  // Name of the level afterwards.
  std::string level;
};

// The level changed, and no rule did it.
struct LevelChange {
  std::string to;
  // As in DecisionRecord.
  std::string cause;
  int64_t time_unix_ns = 0;
};

// An alert that the events before it are saved with.
struct GraveAlert {
  std::string id;
  std::string rule;
  engine::Severity severity = engine::Severity::kHigh;
  std::string text;
  int64_t time_unix_ns = 0;
};

// What rules judge the next event by.
struct RulesState {
  // Id of the bundle.
  std::string bundle_id;
  std::string level;
  absl::btree_map<std::string, lang::Value> variables;
  std::shared_ptr<const ros2::RosGraph> graph;
  // There is a graph to be judged.
  bool settled = false;
  int64_t time_unix_ns = 0;
  // `Uptime`, nanoseconds.
  int64_t uptime_ns = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_JUDGED_EVENT_H_
