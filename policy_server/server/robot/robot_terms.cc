// Robot: terms that an actuator shows and an administrator lets the server go above.
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/robot.h"

namespace rips::pipeline {

// What `order` is about; why it cannot be done.
absl::StatusOr<ShownTerm> Robot::TermToReset(const TermResetOrder& order) const {
  if (draining_) return absl::UnavailableError("the server is stopping");
  if (!outbox_.held_back().none()) {
    // Decided anew, its level would be commanded before it is durable.
    return absl::UnavailableError("a lowering is being recorded; try again");
  }
  if (order.reason.empty() || order.reason.size() > kReasonBytesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat("a reason of 1 to ", kReasonBytesMax, " bytes is required"));
  }
  const auto it = actuators_.find(order.host);
  if (it == actuators_.end()) {
    return absl::NotFoundError(absl::StrCat("the inventory lists no actuator `",
                                            absl::CHexEscape(order.host), "` of robot `",
                                            config_.id, "`"));
  }
  if (!it->second.refused_term) {
    return absl::FailedPreconditionError(
        absl::StrCat("actuator ", order.host, " was not refused for its term: nothing to reset"));
  }
  const ShownTerm shown = *it->second.refused_term;
  const TermJump jump =
      JudgeTerm(shown, {.term = state_.level.term(), .epoch = state_.level.decision_id().epoch},
                std::nullopt);
  if (jump == TermJump::kOutOfReach) {
    return absl::FailedPreconditionError(absl::StrCat("actuator ", order.host, " has obeyed term ",
                                                      shown.term(), "; ",
                                                      TermRemedy(jump, config_.id, order.host)));
  }
  return shown;
}

void Robot::ResetTerm(const TermResetOrder& order, LevelReply reply) {
  const absl::StatusOr<ShownTerm> shown = TermToReset(order);
  if (!shown.ok()) return reply({.status = shown.status()});
  ports_.recorder->NextTerm(
      config_.id, std::max(shown->term(), state_.level.term()),
      // On another thread this robot may be gone by then; what is posted is dropped if it is.
      [this, post = ports_.post, order, reply](const absl::StatusOr<uint64_t>& term) {
        post([=, this] { OnTermToReset(order, term, reply); });
      });
}

void Robot::OnTermToReset(const TermResetOrder& order, const absl::StatusOr<uint64_t>& term,
                          LevelReply reply) {
  // While the store answered, the actuator may have come back, or an operator been faster.
  const absl::StatusOr<ShownTerm> shown = TermToReset(order);
  if (!shown.ok()) return reply({.status = shown.status()});
  if (!term.ok()) return reply({.status = absl::UnavailableError(term.status().message())});
  const uint64_t before = state_.level.term();
  if (*term <= std::max(shown->term(), before)) {
    return reply({.status = absl::UnavailableError("the terms have moved; try again")});
  }
  ActuatorHost& host = actuators_.at(order.host);
  host.refused_term.reset();
  host.pardoned_term = *shown;
  state_.level.RaiseTerm(*term);
  OwnAlert(engine::Severity::kHigh,
           absl::StrCat("operator ", order.operator_name, " lets the server go above term ",
                        shown->term(), " of actuator ", order.host, ", from ", before, " to ",
                        *term, ": ", order.reason));
  const levels::Cause cause{.kind = levels::Cause::Kind::kOperator,
                            .name = order.operator_name,
                            .reason = absl::StrCat("reset-term ", order.host, ": ", order.reason)};
  Decide(state_.level.Reaffirm(cause, ports_.clock->Now()), LevelOrder{}, std::move(reply), {});
}

}  // namespace rips::pipeline
