// Robot: terms that an actuator shows and an administrator lets the server go above.
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/robot.h"

namespace rips::pipeline {

void Robot::ResetTerm(const TermResetOrder& order, LevelReply reply) {
  LevelAnswer answer;
  const auto refuse = [&](absl::Status why) {
    answer.status = std::move(why);
    reply(answer);
  };
  if (draining_) return refuse(absl::UnavailableError("the server is stopping"));
  if (!awaiting_durable_.none()) {
    // Decided anew, its level would be commanded before it is durable.
    return refuse(absl::UnavailableError("a lowering is being recorded; try again"));
  }
  if (order.reason.empty() || order.reason.size() > kReasonBytesMax) {
    return refuse(absl::InvalidArgumentError(
        absl::StrCat("a reason of 1 to ", kReasonBytesMax, " bytes is required")));
  }
  const auto it = actuators_.find(order.host);
  if (it == actuators_.end()) {
    return refuse(absl::NotFoundError(absl::StrCat("the inventory lists no actuator `",
                                                   absl::CHexEscape(order.host), "` of robot `",
                                                   config_.id, "`")));
  }
  ActuatorHost& host = it->second;
  if (!host.refused_term) {
    return refuse(absl::FailedPreconditionError(
        absl::StrCat("actuator ", order.host, " was not refused for its term: nothing to reset")));
  }
  const ShownTerm shown = *host.refused_term;
  const TermJump jump = JudgeTerm(
      shown, {.term = state_.level.term(), .epoch = state_.level.mark().epoch}, std::nullopt);
  if (jump == TermJump::kOutOfReach) {
    return refuse(absl::FailedPreconditionError(
        absl::StrCat("actuator ", order.host, " has obeyed term ", shown.term(), "; ",
                     TermRemedy(jump, config_.id, order.host))));
  }
  const uint64_t before = state_.level.term();
  const absl::StatusOr<uint64_t> term =
      ports_.recorder->NextTerm(config_.id, std::max(shown.term(), before));
  if (!term.ok()) return refuse(absl::UnavailableError(term.status().message()));
  host.refused_term.reset();
  host.pardoned_term = shown;
  state_.level.RaiseTerm(*term);
  OwnAlert(engine::Severity::kHigh,
           absl::StrCat("operator ", order.operator_name, " lets the server go above term ",
                        shown.term(), " of actuator ", order.host, ", from ", before, " to ", *term,
                        ": ", order.reason));
  const levels::Cause cause{.kind = levels::Cause::Kind::kOperator,
                            .name = order.operator_name,
                            .reason = absl::StrCat("reset-term ", order.host, ": ", order.reason)};
  Decide(state_.level.Reaffirm(cause, ports_.clock->Now()), LevelOrder{}, std::move(reply),
         std::move(answer));
}

}  // namespace rips::pipeline
