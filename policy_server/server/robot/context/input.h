// What reaches the core of a robot, each as a value: RobotCore::On judges one at a time.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_INPUT_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_INPUT_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/engine/state/effect.h"
#include "policy_server/policy/engine/state/verdict.h"
#include "policy_server/server/robot/context/policy.h"
#include "policy_server/server/robot/context/watch.h"
#include "policy_server/server/robot/model/actuator_inbound.h"
#include "policy_server/server/robot/model/drill_order.h"
#include "policy_server/server/robot/model/inbound.h"
#include "policy_server/server/robot/model/level_order.h"
#include "policy_server/server/robot/model/robot_config.h"
#include "policy_server/server/store/generations.h"
#include "services/base/clock.h"
#include "services/base/decision_id.h"

namespace rips::pipeline {

// Names one stream of an agent, never twice in the life of a core. 0 = none.
using SessionId = uint64_t;
// Names an operator's order until it is answered. 0 = no answer is wanted.
using ReplyToken = uint64_t;

// What the core knows of the outside while it judges an input.
struct Moment {
  Instant now;
  // The last write to the store succeeded.
  bool store_writable = true;
  // Events are recorded: each one that is judged is an action, too.
  bool recorded = false;
  // What agents sent waits for its turn for too long.
  bool backlog = false;
};

namespace input {

// ---- sensors
struct SensorHello {
  std::string host;
  SessionId session = 0;
  pipeline::SensorHello hello;
  // Of our store, by now.
  store::StorePoint store;
  // Our store goes on from the point that the hello names.
  bool store_goes_on = true;
};
struct SensorHeartbeat {
  std::string host;
  SessionId session = 0;
  pipeline::SensorHeartbeat heartbeat;
};
struct InterestAnswer {
  std::string host;
  SessionId session = 0;
  pipeline::InterestAnswer answer;
};
// The sensor was sent its interest (action::SetInterest), under this id.
struct InterestSent {
  std::string host;
  SessionId session = 0;
  std::string id;
};
struct SensorBatch {
  std::string host;
  SessionId session = 0;
  std::shared_ptr<const Batch> batch;
};
struct SensorGone {
  std::string host;
  SessionId session = 0;
};
// Judges one piece of what sensors have sent; see RobotCore::has_control.
struct Advance {};
struct Inspected {
  // As in action::Inspect.
  uint64_t ticket = 0;
  size_t index = 0;
  std::vector<uint32_t> asked;
  // One for each of `asked`.
  std::vector<engine::Verdict> verdicts;
};

// ---- actuators
struct ActuatorHello {
  std::string host;
  SessionId session = 0;
  pipeline::ActuatorHello hello;
};
struct ActuatorHeartbeat {
  std::string host;
  SessionId session = 0;
  pipeline::ActuatorHeartbeat heartbeat;
};
struct Receipt {
  std::string host;
  SessionId session = 0;
  pipeline::Receipt receipt;
};
struct ActuatorGone {
  std::string host;
  SessionId session = 0;
};

// ---- operators and the server
struct Raise {
  LevelOrder order;
  ReplyToken token = 0;
};
struct DeEscalate {
  LevelOrder order;
  ReplyToken token = 0;
};
struct Approve {
  ApprovalOrder order;
  ReplyToken token = 0;
};
// A certificate of that operator is banned (LevelOrder::identity).
struct OperatorBanned {
  std::string identity;
};
struct ResetTerm {
  TermResetOrder order;
  ReplyToken token = 0;
};
struct ResumeRules {
  std::string operator_name;
  std::string reason;
  ReplyToken token = 0;
};
struct SetMaintenance {
  MaintenanceOrder order;
  ReplyToken token = 0;
};
struct SendSignal {
  SignalOrder order;
  ReplyToken token = 0;
};
struct StartDrill {
  DrillOrder order;
  ReplyToken token = 0;
};
struct RefusedOrder {
  LevelOrder order;
  absl::Status why;
};
struct Report {
  engine::Severity severity = engine::Severity::kInfo;
  std::string text;
  // Alerts of one kind share a limit.
  std::string kind;
};
struct SwapPolicy {
  Policy policy;
  ReplyToken token = 0;
};
// A policy runs muted beside the one in force; null: none does.
struct WatchAlso {
  std::shared_ptr<const AlsoWatched> also;
};
struct SetHosts {
  RobotConfig config;
};
struct PolicyProblem {
  std::string problem;
};
struct Drain {};
// The server no longer judges the robot.
struct Retire {
  absl::Status why;
};

// ---- the store, the time
// Of the batch of the last action::Record. Aborted, here and in TermDrawn: the robot has another
// owner.
struct Recorded {
  absl::Status status;
  store::StorePoint store;
};
// Of the batch of an action::SaveRaises that was written.
struct RaisesSaved {
  std::vector<DecisionId> decisions;
};
// Of an action::FindDecision. nullopt: no decision has that id.
struct DecisionFound {
  uint64_t question = 0;
  absl::StatusOr<std::optional<std::string>> level;
};
// Of an action::DrawTerm.
struct TermDrawn {
  uint64_t question = 0;
  absl::StatusOr<uint64_t> term;
};
// At least every 50 ms.
// Of the agent of this host (`sensor`: its sensor, else its actuator), from `peer`.
struct KeyMisused {
  bool sensor = false;
  std::string host;
  std::string peer;
};
struct Time {};

}  // namespace input

using Input =
    std::variant<input::SensorHello, input::SensorHeartbeat, input::InterestAnswer,
                 input::InterestSent, input::SensorBatch, input::SensorGone, input::Advance,
                 input::Inspected, input::ActuatorHello, input::ActuatorHeartbeat, input::Receipt,
                 input::ActuatorGone, input::Raise, input::DeEscalate, input::Approve,
                 input::OperatorBanned, input::ResetTerm, input::ResumeRules, input::SetMaintenance,
                 input::SendSignal, input::StartDrill, input::RefusedOrder, input::Report,
                 input::KeyMisused, input::SwapPolicy, input::WatchAlso, input::SetHosts,
                 input::PolicyProblem, input::Drain, input::Retire, input::Recorded,
                 input::RaisesSaved, input::DecisionFound, input::TermDrawn, input::Time>;

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_INPUT_H_
