// Robot: drills. They touch nothing of the level, its commands, chains or budgets.
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/robot/robot.h"

namespace rips::pipeline {

void Robot::StartDrill(const DrillOrder& order, DrillReply reply) {
  std::vector<DrillRun::Host> hosts;
  bool attached = false;
  for (const auto& [name, host] : actuators_) {
    hosts.push_back({.name = name, .attached = host.session.has_value()});
    attached |= host.session.has_value();
  }
  absl::Status status;
  if (!order.level.empty() && !levels().Find(order.level)) {
    status = absl::InvalidArgumentError(
        absl::StrCat("`", absl::CHexEscape(order.level.substr(0, 100)), "` is not a level of ",
                     config_.id, " (", absl::StrJoin(levels().names(), ", "), ")"));
  } else if (draining_) {
    status = absl::UnavailableError("the server is stopping");
  } else if (drill_) {
    status = absl::FailedPreconditionError(
        absl::StrCat("a drill of ", config_.id, " by ", drill_->order.operator_name,
                     " is under way; it is over within ", kDrillAnswerNs / kNanosPerSecond, " s"));
  } else if (!attached) {
    status =
        absl::FailedPreconditionError(absl::StrCat("no actuator of ", config_.id, " is attached"));
  }
  if (!status.ok()) return reply({.status = status, .drills = {}});

  const Instant now = ports_.clock->Now();
  const std::vector<std::string> wanted =
      order.level.empty() ? levels().names() : std::vector<std::string>{order.level};
  OwnAlert(engine::Severity::kInfo, absl::StrCat("drill by ", order.operator_name,
                                                 " begins: ", absl::StrJoin(wanted, ", ")));
  drill_.emplace(RunningDrill{.order = order,
                              .run = DrillRun(wanted, hosts, ports_.new_id, now),
                              .reply = std::move(reply)});
  AdvanceDrill(now);
  Flush();
}

void Robot::AdvanceDrill(Instant now) {
  if (!drill_) return;
  for (const Outgoing& outgoing : drill_->run.Due(state_.level.term(), now)) {
    const auto it = actuators_.find(outgoing.host);
    if (it == actuators_.end() || !it->second.session) continue;
    receipts_.Sent(outgoing.host, outgoing.command);
    it->second.session->link->Send(outgoing.command);
  }
  if (draining_ || drill_->run.Over(now)) EndDrill();
}

void Robot::EndDrill() {
  RunningDrill ended = *std::exchange(drill_, std::nullopt);
  DrillAnswer answer;
  answer.drills = ended.run.TakeEntries();
  if (draining_) answer.status = absl::UnavailableError("the server is stopping");
  OwnAlert(
      AllWork(answer.drills) ? engine::Severity::kInfo : engine::Severity::kMedium,
      absl::StrCat("drill by ", ended.order.operator_name, " is over: ", Summary(answer.drills)));
  ended.reply(answer);
}

}  // namespace rips::pipeline
