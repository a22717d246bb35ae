// Judges what sensors have sent, observation by observation: what each changes, and the event that
// rules are run on. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CORE_JUDGE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CORE_JUDGE_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/strings/string_view.h"
#include "absl/types/span.h"
#include "policy_server/policy/engine/evaluator.h"
#include "policy_server/server/robot/actuators/actuator_side.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/durable_outbox.h"
#include "policy_server/server/robot/context/evidence_gate.h"
#include "policy_server/server/robot/core/late_graph.h"
#include "policy_server/server/robot/decide/decider.h"
#include "policy_server/server/robot/decide/evidence.h"
#include "policy_server/server/robot/line/control_line.h"
#include "policy_server/server/robot/line/inspection_line.h"
#include "policy_server/server/robot/sensors/losses.h"
#include "policy_server/server/robot/sensors/sensor_side.h"
#include "policy_server/server/robot/sight/findings.h"
#include "policy_server/server/robot/sight/sight.h"

namespace rips::pipeline {

// What a judge needs of the core; all outlives it.
struct JudgeParts {
  Context& context;
  engine::RobotState& state;
  EvidenceGate& gate;
  Evidence& evidence;
  DurableOutbox& outbox;
  SensorSide& sensors;
  Losses& losses;
  Findings& findings;
  Sight& sight;
  ActuatorSide& actuators;
  Decider& decider;
};

// Not thread-safe.
class Judge {
 public:
  explicit Judge(const JudgeParts& parts)
      : parts_(parts),
        messages_(&parts.context, &parts.losses, &parts.state),
        control_(&parts.context),
        late_(&parts.context, &parts.state, &parts.gate, &parts.decider) {}

  // A batch waits from now on, if the session is the host's.
  void OnBatch(const input::SensorBatch& in);
  void OnInspected(const input::Inspected& in) { messages_.OnInspected(in); }
  // What messages wait for may have come.
  void Wake() { messages_.Wake(); }
  void Clear();

  // While has_control, Advance comes before other control; while has_messages, before other
  // messages.
  bool has_control() const { return !control_.empty(); }
  bool has_messages() const { return messages_.ready(); }
  // Judges one piece: of control if there is any, else of messages.
  void Advance();
  // Graphs of the past that no message names any more are dropped; rules are run on the one in
  // force if they were run on a former one. Call it often.
  void OnTime();
  // When the graph in force was taken.
  int64_t graph_changed_unix_ns() const { return graph_changed_unix_ns_; }

 private:
  void AdvanceControl();
  void AdvanceMessages();
  void JudgePiece(SensorHost& host, const Piece& piece);
  // `keeps`: the piece's batch, until a message of it was judged; then null.
  void JudgeOne(SensorHost& host, const Piece& piece, size_t index,
                std::shared_ptr<const Batch>& keeps);
  void JudgeMessage(SensorHost& host, const Piece& piece, size_t index, engine::Event event,
                    std::shared_ptr<const Batch>& keeps);
  void JudgeGraph(SensorHost& host, const Piece& piece, const GraphChange& change,
                  int64_t boottime_ns, engine::Event event);
  // Of an incarnation of the sensor that is over: rules are run on it, it is not in force.
  void JudgeFormerGraph(SensorHost& host, const Batch& batch, const Observation& seen,
                        engine::Event event);
  // `told_by` holds the change that led from the graph in force to the host's; null if several did.
  void OnGraph(SensorHost& host, engine::Event event, std::shared_ptr<const Batch> told_by);
  bool Concerns(absl::string_view topic) const { return parts_.context.watch.Concerns(topic); }

  JudgeParts parts_;
  InspectionLine messages_;
  ControlLine control_;
  LateGraph late_;
  // Which graph of a sensor is in force; none after a change of it that is not.
  struct InForce {
    std::string incarnation;
    uint64_t version = 0;

    friend bool operator==(const InForce&, const InForce&) = default;
  };
  std::optional<InForce> in_force_;
  int64_t graph_changed_unix_ns_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CORE_JUDGE_H_
