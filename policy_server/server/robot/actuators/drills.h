// Drills of one robot, one at a time. They change nothing of the level, its commands, chains or
// budgets. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_DRILLS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_DRILLS_H_

#include <optional>
#include <string>

#include "absl/status/status.h"
#include "policy_server/server/robot/actuators/actuator_side.h"
#include "policy_server/server/robot/actuators/drill_run.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Drills {
 public:
  Drills(Context* context, Alerts* alerts, ActuatorSide* actuators,
         const levels::LevelMachine* level)
      : context_(*context), alerts_(*alerts), actuators_(*actuators), level_(*level) {}

  // Answered when each actuator has, or after kDrillAnswerNs. InvalidArgument for no level of the
  // robot, FailedPrecondition if no actuator is attached or another drill is under way.
  void Start(const input::StartDrill& in);
  // Sends what is due, and answers a drill that is over. Call at least each 100 ms.
  void Advance();
  // False if the receipt is of no drill.
  bool OnReceipt(const std::string& host, const Receipt& receipt);
  // Its session has ended, or another one begins.
  void OnGone(const std::string& host);
  // Ends what is under way, without an alert.
  void Refuse(const absl::Status& why);

 private:
  struct Running {
    DrillOrder order;
    ReplyToken token = 0;
    DrillRun run;
  };
  absl::Status Check(const DrillOrder& order) const;
  void End();

  Context& context_;
  Alerts& alerts_;
  ActuatorSide& actuators_;
  const levels::LevelMachine& level_;
  std::optional<Running> running_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_DRILLS_H_
