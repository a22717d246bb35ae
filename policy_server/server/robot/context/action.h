// What the core of a robot wants done. The shell performs actions in their order.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ACTION_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ACTION_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "policy_server/policy/engine/interest/interest.h"
#include "policy_server/policy/engine/state/event.h"
#include "policy_server/server/robot/context/input.h"
#include "policy_server/server/robot/model/coverage.h"
#include "policy_server/server/robot/model/drill_order.h"
#include "policy_server/server/robot/model/inspected_message.h"
#include "policy_server/server/robot/model/judged_event.h"
#include "policy_server/server/robot/model/level_order.h"
#include "policy_server/server/robot/model/outbound.h"
#include "policy_server/server/robot/model/robot_status.h"
#include "policy_server/server/store/records.h"
#include "services/base/decision_id.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

enum class Counter {
  kObservationsJudged,
  kObservationsLost,
  kObservationsDuplicate,
  kMessagesUnattributed,
  kGraphsMerged,
  kSessionsRefused,
  kPayloadsCut,
  kAlerts,
  kAlertsLost,
};

namespace action {

// ---- to an agent; nothing happens if the session has ended
struct Setup {
  SessionId session = 0;
  SensorSetup setup;
};
struct Acknowledge {
  SessionId session = 0;
  std::string incarnation;
  Lane lane = Lane::kControl;
  uint64_t sequence = 0;
  // Of the store's generation, which has it all.
  uint64_t commit = 0;
};
// Cumulative since the session began.
struct GrantCredit {
  SessionId session = 0;
  uint64_t message_bytes = 0;
  uint64_t payload_bytes = 0;
};
struct EchoHeartbeat {
  SessionId session = 0;
  int64_t echo_boottime_ns = 0;
};
// To be answered with input::InterestSent.
struct SetInterest {
  std::string host;
  SessionId session = 0;
  std::shared_ptr<const engine::InterestPlan> plan;
  engine::PayloadLimits limits;
  std::shared_ptr<const ros2::TopicNames> kept_topics;
};
struct GrantLease {
  SessionId session = 0;
  LeaseGrant lease;
};
struct SendCommand {
  SessionId session = 0;
  Command command;
};
// Of either kind of agent.
struct Close {
  SessionId session = 0;
  absl::Status status;
};

// ---- to the store, each to be answered
// Its alerts go to observers when it is durable. Input: Recorded.
struct Record {
  std::shared_ptr<const store::WriteBatch> batch;
};
// From the store's reserve; RaisesSaved if it was written.
struct SaveRaises {
  store::WriteBatch raises;
};
// DecisionFound.
struct FindDecision {
  uint64_t question = 0;
  DecisionId decision_id;
};
// TermDrawn.
struct DrawTerm {
  uint64_t question = 0;
  uint64_t tenure = 0;
  uint64_t above = 0;
};

// ---- to others
// The robot has retired; once. Aborted: it has another owner, and nothing that it decides is
// recorded any more.
struct ReportRetired {
  absl::Status why;
};
// To be answered with Inspected.
struct Inspect {
  std::shared_ptr<Inspector> inspector;
  uint64_t ticket = 0;
  size_t index = 0;
  std::vector<uint32_t> inspections;
  InspectedMessage message;
};
struct AnswerOrder {
  ReplyToken token = 0;
  LevelAnswer answer;
};
struct AnswerDrill {
  ReplyToken token = 0;
  DrillAnswer answer;
};
struct PublishStatus {
  RobotStatus status;
};
struct LogRule {
  std::string rule;
  std::string text;
};
// See EventRecorder. `batch`:
//   of a message   of several of one batch among these actions, the first that is not muted has it,
//                  and the muted ones before it
//   of a graph     holds the one change of a graph that led from the newest to this one; null if
//                  several did, or a snapshot
struct RecordEvent {
  JudgedEvent event;
};
struct RecordLevel {
  LevelChange level;
};
// See ShadowRecorder.
struct RecordOutcome {
  RuleOutcome outcome;
};
// What was recorded so far is saved with that alert.
struct KeepRecording {
  GraveAlert alert;
};

// ---- metrics
struct Count {
  Counter counter = Counter::kAlerts;
  uint64_t by = 0;
};
struct CountEndpoints {
  EndpointCounts counts;
};
struct CountBlind {
  size_t reasons = 0;
};
struct CountLeftOut {
  uint64_t left_out = 0;
  bool began = false;
};
struct ShowClockSkew {
  std::string host;
  int64_t skew_ns = 0;
};
struct CountSkipped {
  // One of kSkipReasons.
  const char* reason = nullptr;
  uint64_t inspections = 0;
};

}  // namespace action

using Action =
    std::variant<action::Setup, action::Acknowledge, action::GrantCredit, action::EchoHeartbeat,
                 action::SetInterest, action::GrantLease, action::SendCommand, action::Close,
                 action::Record, action::SaveRaises, action::FindDecision, action::DrawTerm,
                 action::Inspect, action::AnswerOrder, action::AnswerDrill, action::PublishStatus,
                 action::ReportRetired, action::LogRule, action::RecordEvent, action::RecordLevel,
                 action::RecordOutcome, action::KeepRecording, action::Count,
                 action::CountEndpoints, action::CountBlind, action::CountLeftOut,
                 action::ShowClockSkew, action::CountSkipped>;
using Actions = std::vector<Action>;

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_ACTION_H_
