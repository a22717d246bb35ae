#include "policy_server/server/robot/decide/orders.h"

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/engine/foresight.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {
namespace {

constexpr size_t kRefusedOrdersMax = 256;

absl::Status RefusalStatus(const levels::Transition& transition, const levels::LevelTable& table) {
  return absl::FailedPreconditionError(absl::StrCat(
      "the level stays ", table.name(transition.from), ": ", levels::ToString(transition.refusal),
      transition.detail.empty() ? "" : absl::StrCat("; ", transition.detail)));
}

absl::Status NoLevel(const std::string& level, const std::string& robot,
                     const levels::LevelTable& table) {
  return absl::InvalidArgumentError(absl::StrCat("`", absl::CHexEscape(level),
                                                 "` is not a level of ", robot, " (",
                                                 absl::StrJoin(table.names(), ", "), ")"));
}

levels::Cause CauseOf(const LevelOrder& order) {
  return {
      .kind = levels::Cause::Kind::kOperator, .name = order.operator_name, .reason = order.reason};
}

}  // namespace

absl::Status Orders::CheckReason(const std::string& reason) {
  if (!reason.empty() && reason.size() <= kReasonBytesMax) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("a reason of 1 to ", kReasonBytesMax, " bytes is required"));
}

bool Orders::AnsweredAlready(const LevelOrder& order, ReplyToken token) {
  if (auto repeated = decider_.orders().Repeated(order.request_id)) {
    context_.Do(action::AnswerOrder{token, *std::move(repeated)});
    return true;
  }
  if (!context_.draining) return false;
  context_.Do(
      action::AnswerOrder{token, {.status = absl::UnavailableError("the server is stopping")}});
  return true;
}

void Orders::OnRaise(const input::Raise& in) {
  const LevelOrder& order = in.order;
  if (AnsweredAlready(order, in.token)) return;
  const auto to = levels().Find(order.to);
  const absl::Status status =
      to ? CheckReason(order.reason) : NoLevel(order.to, context_.config.id, levels());
  if (!status.ok()) return context_.Do(action::AnswerOrder{in.token, {.status = status}});
  levels::LevelMachine trial = state_.level;
  levels::LevelMachine& machine = order.dry_run ? trial : state_.level;
  Decide(machine.Raise(*to, CauseOf(order), context_.now()), order, {.token = in.token});
}

void Orders::OnDeEscalate(const input::DeEscalate& in) {
  const LevelOrder& order = in.order;
  if (AnsweredAlready(order, in.token)) return;
  LevelAnswer answer;
  answer.status = CheckLowering(order, answer);
  if (!answer.status.ok()) {
    return context_.Do(action::AnswerOrder{in.token, std::move(answer)});
  }
  levels::LevelMachine trial = state_.level;
  levels::Transition transition = Lower(order, trial);
  answer.needs_approval = transition.decided() && approvals_.Needed(transition.to);
  if (answer.needs_approval && !order.dry_run) {
    answer.decision_id = state_.level.decision_id();
    answer.decided_level = levels().name(state_.level.level());
    approvals_.Ask(order, answer);
    return context_.Do(action::AnswerOrder{in.token, std::move(answer)});
  }
  if (!order.dry_run) transition = Lower(order, state_.level);
  Decide(transition, order, {.token = in.token, .answer = std::move(answer)});
}

levels::Transition Orders::Lower(const LevelOrder& order, levels::LevelMachine& machine) const {
  return machine.DeEscalate(*levels().Find(order.to), CauseOf(order), context_.now(),
                            *levels().Find(order.expected_level), order.expected_decision_id);
}

void Orders::OnApprove(const input::Approve& in) {
  const ApprovalOrder& order = in.order;
  if (AnsweredAlready({.request_id = order.request_id}, in.token)) return;
  absl::StatusOr<LevelOrder> lowering = approvals_.Find(order);
  LevelAnswer answer{.status = lowering.status(),
                     .decision_id = state_.level.decision_id(),
                     .decided_level = levels().name(state_.level.level())};
  if (answer.status.ok()) answer.status = CheckReason(order.reason);
  if (answer.status.ok() && !order.reject && order.identity == lowering->identity) {
    answer.status = absl::PermissionDeniedError(
        "who asks for a lowering cannot approve it; another operator must");
    OnRefused({.order = {.operator_name = order.operator_name, .to = lowering->to},
               .why = answer.status});
  }
  if (answer.status.ok() && order.reject) {
    approvals_.Remove(order.id);
    alerts_.RaiseOfKind(
        absl::StrCat("approval by ", order.identity), engine::Severity::kInfo,
        absl::StrCat("operator ", order.operator_name, " rejects to lower ", context_.config.id,
                     " to ", lowering->to, " (", order.id.substr(0, 8), "), for which operator ",
                     lowering->operator_name, " asked: ", order.reason));
    return context_.Do(action::AnswerOrder{in.token, std::move(answer)});
  }
  if (answer.status.ok()) {
    lowering->accept_blind = lowering->accept_blind && order.accept_blind;
    lowering->request_id = order.request_id;
    answer.status = CheckLowering(*lowering, answer);
    if (!answer.status.ok() && order.accept_blind && !answer.blind_because.empty()) {
      answer.status = absl::FailedPreconditionError(absl::StrCat(
          "RIPS does not see all of ", context_.config.id,
          " now: ", absl::StrJoin(answer.blind_because, "; "),
          "; both operators must accept that: it was asked for without --accept-blind"));
    }
  }
  const std::string changes =
      ros2::Printable(absl::StrJoin(approvals_.ChangesSince(order.id), ", "));
  if (answer.status.ok() && !changes.empty() && !order.accept_changes) {
    answer.status = absl::FailedPreconditionError(
        absl::StrCat("the robot's graph has changed since it was asked for: ", changes,
                     "; --accept-changes approves it all the same"));
  }
  if (!answer.status.ok()) {
    return context_.Do(action::AnswerOrder{in.token, std::move(answer)});
  }
  approvals_.Remove(order.id);
  lowering->operator_name =
      absl::StrCat(lowering->operator_name, ", approved by ", order.operator_name);
  // Each is within the limit of a reason; both together need not be.
  lowering->reason = absl::StrCat(lowering->reason, "; approved: ", order.reason);
  if (!changes.empty()) {
    absl::StrAppend(&lowering->reason, "; accepted: ", changes);
  }
  Decide(Lower(*lowering, state_.level), *lowering,
         {.token = in.token, .answer = std::move(answer)});
}

absl::Status Orders::CheckLowering(const LevelOrder& order, LevelAnswer& answer) const {
  const auto to = levels().Find(order.to);
  if (!to) return NoLevel(order.to, context_.config.id, levels());
  if (!levels().Find(order.expected_level))
    return NoLevel(order.expected_level, context_.config.id, levels());
  RIPS_RETURN_IF_ERROR(CheckReason(order.reason));
  if (!context_.moment.store_writable) {
    return absl::FailedPreconditionError(
        "the server's store cannot be written, and a lowering must be recorded first; raising "
        "works");
  }
  answer.blind_because = evidence_.Problems();
  answer.would_raise_again = engine::WouldRaise(*to, context_.now(), state_);
  if (answer.blind_because.empty() || order.accept_blind || order.dry_run) {
    return absl::OkStatus();
  }
  return absl::FailedPreconditionError(absl::StrCat(
      "RIPS does not see all of ", context_.config.id, " now: ",
      absl::StrJoin(answer.blind_because, "; "), "; --accept-blind lowers it all the same"));
}

void Orders::Decide(const levels::Transition& transition, const LevelOrder& order,
                    action::AnswerOrder answer) {
  LevelAnswer& out = answer.answer;
  out.decision_id = transition.decided() ? transition.decision_id : state_.level.decision_id();
  const levels::LevelIndex level = transition.refused() ? transition.from : transition.to;
  out.decided_level = levels().name(level);
  out.soft = levels().at(level).soft;
  if (transition.refused()) out.status = RefusalStatus(transition, levels());
  if (!order.dry_run) decider_.OnTransition({.transition = transition});
  if (order.dry_run || !transition.decided()) return context_.Do(std::move(answer));
  ReportChange(transition, order, out);
  decider_.orders().Wait(transition.decision_id, order.request_id, std::move(answer));
}

void Orders::ReportChange(const levels::Transition& transition, const LevelOrder& order,
                          const LevelAnswer& answer) {
  if (transition.from == transition.to) return;
  const bool lowers = transition.lowers();
  const bool blind = lowers && !answer.blind_because.empty();
  alerts_.RaiseOfKind(
      // One change is not folded away among others: each has a limit of its own.
      absl::StrCat("order by ", order.operator_name, "\n", levels().name(transition.from), "\n",
                   levels().name(transition.to), blind ? "\nblind" : ""),
      blind    ? engine::Severity::kHigh
      : lowers ? engine::Severity::kMedium
               : engine::Severity::kLow,
      absl::StrCat("operator ", order.operator_name, lowers ? " lowers " : " raises ",
                   context_.config.id, " from ", levels().name(transition.from), " to ",
                   levels().name(transition.to),
                   blind ? absl::StrCat(", though RIPS does not see all of it (",
                                        absl::StrJoin(answer.blind_because, "; "), ")")
                         : "",
                   ": ", order.reason));
}

void Orders::OnResume(const input::ResumeRules& in) {
  const absl::Status status = CheckReason(in.reason);
  if (status.ok()) {
    const bool halted = state_.halted();
    decider_.Resume();
    alerts_.Raise(engine::Severity::kInfo,
                  absl::StrCat("operator ", in.operator_name,
                               halted ? " lets rules run again, and lower soft levels: "
                                      : " lets rules lower soft levels again: ",
                               in.reason));
  }
  context_.Do(action::AnswerOrder{in.token, {.status = status}});
}

void Orders::OnSignal(const input::SendSignal& in) {
  const SignalOrder& order = in.order;
  LevelAnswer answer{.status = CheckReason(order.reason)};
  if (answer.status.ok() && order.signal != "SIGUSR1" && order.signal != "SIGUSR2") {
    answer.status = absl::InvalidArgumentError(
        absl::StrCat("`", ros2::Printable(order.signal), "` is neither SIGUSR1 nor SIGUSR2"));
  }
  if (answer.status.ok() && state_.halted()) {
    answer.status = absl::FailedPreconditionError(
        absl::StrCat("a rule of ", context_.config.id,
                     " has called `crash`: no rule runs until an operator resumes them"));
  }
  if (answer.status.ok()) {
    alerts_.RaiseOfKind(absl::StrCat("signal by ", order.operator_name), engine::Severity::kInfo,
                        absl::StrCat("operator ", order.operator_name, " sends ", order.signal,
                                     " to ", context_.config.id, ": ", order.reason));
    answer.level_before = levels().name(state_.level.level());
    decider_.Run(
        {.what = engine::ExternalEvent(model::SignalSeen{.name = order.signal, .count = 1}),
         .time_unix_ns = context_.now().unix_ns},
        {.remark = absl::StrCat(" sent by operator ", order.operator_name)});
    decider_.RunEvents();
    answer.decided_level = levels().name(state_.level.level());
  }
  context_.Do(action::AnswerOrder{in.token, std::move(answer)});
}

void Orders::OnRefused(const input::RefusedOrder& in) {
  const std::string cause = absl::StrCat("operator ", in.order.operator_name);
  const std::string key = absl::StrCat(cause, "\n", in.order.to);
  if (!levels().Find(in.order.to)) return;
  if (refused_.size() >= kRefusedOrdersMax && !refused_.contains(key)) return;
  auto [it, fresh] = refused_.try_emplace(key);
  if (fresh) it->second.first = context_.ids.Next();
  const uint64_t count = ++it->second.second;
  if ((count & (count - 1)) != 0) return;  // written at 1, 2, 4, 8, ...
  alerts_.RaiseOfKind(
      absl::StrCat("refused ", cause), engine::Severity::kMedium,
      absl::StrCat(cause, " was refused to move ", context_.config.id, " to ", in.order.to, ", ",
                   count, count == 1 ? " time: " : " times: ", in.why.message()));
  outbox_.AddRefusal({.id = it->second.first,
                      .from = levels().name(state_.level.level()),
                      .to = in.order.to,
                      .cause = cause,
                      .reason = std::string(in.why.message()),
                      .count = count,
                      .time_unix_ns = context_.now().unix_ns});
}

void Orders::RefuseAll(const absl::Status& why) {
  for (action::AnswerOrder& answer : decider_.orders().RefuseAll(why)) {
    context_.Do(std::move(answer));
  }
}

}  // namespace rips::pipeline
