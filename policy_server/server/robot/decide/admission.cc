#include "policy_server/server/robot/decide/admission.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/base/cut_text.h"
#include "services/base/status_macros.h"

namespace rips::pipeline {
namespace {

// Of a list of levels in an alert and in the status of a stream, which gRPC sends as a header.
constexpr size_t kLevelsTextBytesMax = 1'024;

std::string LevelsText(const std::vector<std::string>& levels) {
  return Shortened(absl::StrJoin(levels, ", "), kLevelsTextBytesMax);
}

}  // namespace

std::string Admission::OnHello(const input::ActuatorHello& in) {
  if (absl::Status status = Check(in); !status.ok()) {
    context_.Do(action::Close{in.session, std::move(status)});
    return "";
  }
  Host& host = hosts_[in.host];
  host.refused_term.reset();
  const DecisionId& held = in.hello.decision_id;
  if (const DecisionId verified = actuators_.verified(in.host); !held.none() && held < verified) {
    alerts_.Raise(engine::Severity::kCritical,
                  absl::StrCat("actuator ", in.host, " holds decision ", ToString(held),
                               " although it has verified ", ToString(verified),
                               ": its state was deleted or went back"));
  }
  if (host.arming != 0) {
    context_.Do(action::Close{host.arming, absl::AbortedError("replaced by a newer session")});
  }
  host.arming = in.session;
  return GoOn({.in = in, .term = std::nullopt, .level = std::nullopt});
}

absl::Status Admission::Check(const input::ActuatorHello& in) {
  const ActuatorHello& hello = in.hello;
  const levels::LevelTable& levels = state_.level.table();
  const std::string& robot = context_.config.id;
  if (!actuators_.Lists(in.host)) {
    return absl::PermissionDeniedError(
        absl::StrCat("the inventory lists no actuator `", in.host, "` of robot `", robot, "`"));
  }
  const std::string agent = absl::StrCat("actuator ", in.host);
  if (actuators_.HasLiveSession(in.host)) {
    own_agents_.OnRefused(agent, hello.peer);
    return absl::AlreadyExistsError(
        absl::StrCat("actuator ", robot, "/", in.host, " has a live session"));
  }
  own_agents_.OnSession(agent, hello.peer);
  if (hello.levels != levels.names()) {
    const std::string text =
        absl::StrCat(agent, " is not armed: its levels (", LevelsText(hello.levels),
                     ") are not those of the bundle (", LevelsText(levels.names()), ")");
    alerts_.Raise(engine::Severity::kCritical, text);
    return absl::FailedPreconditionError(text);
  }
  Host& host = hosts_[in.host];
  const ShownTerm shown = {.decision_id = hello.decision_id, .highest_term = hello.highest_term};
  const TermJump jump =
      JudgeTerm(shown, {.term = state_.level.term(), .epoch = state_.level.decision_id().epoch},
                host.pardoned_term);
  if (jump == TermJump::kNear) return absl::OkStatus();
  host.refused_term = shown;
  const std::string text =
      absl::StrCat(agent, hello.peer.empty() ? "" : " at ", hello.peer, " names decision ",
                   ToString(hello.decision_id), " and term ", hello.highest_term,
                   ", far beyond ours (", ToString(state_.level.decision_id()), "): not armed; ",
                   TermRemedy(jump, robot, in.host), "; otherwise its key may be in other hands");
  alerts_.Raise(engine::Severity::kCritical, text);
  return absl::FailedPreconditionError(text);
}

std::string Admission::GoOn(Arming arming) {
  const std::string name = arming.in.host;
  const ActuatorHello& hello = arming.in.hello;
  // A term that an actuator has obeyed is never used for other decisions. Ours was drawn at this
  // start: an actuator that this process has not met yet cannot know it.
  const uint64_t obeyed = std::max(hello.highest_term, hello.decision_id.term);
  const uint64_t ours = state_.level.term();
  if (obeyed >= (actuators_.Met(name) ? ours + 1 : ours)) {
    if (!arming.term) {
      context_.Do(action::DrawTerm{
          .question = ++last_question_, .tenure = context_.tenure, .above = obeyed});
      armings_.emplace(last_question_, std::move(arming));
      return "";
    }
    alerts_.Raise(engine::Severity::kHigh,
                  absl::StrCat("actuator ", name, " has obeyed term ", obeyed, ", our term is ",
                               ours, "; commands now carry term ", *arming.term));
    state_.level.RaiseTerm(*arming.term);
  }
  if (!hello.decision_id.none()) {
    // Perhaps not recorded yet.
    const std::optional<std::string> known =
        hello.decision_id == state_.level.decision_id()
            ? state_.level.table().name(state_.level.level())
            : actuators_.reconciler().OrderedLevel(hello.decision_id);
    if (!known && !arming.level) {
      context_.Do(
          action::FindDecision{.question = ++last_question_, .decision_id = hello.decision_id});
      armings_.emplace(last_question_, std::move(arming));
      return "";
    }
    Reconcile(arming.in, known ? known : *arming.level);
  }
  hosts_[name].arming = 0;
  actuators_.Arm(arming.in);
  return name;
}

std::string Admission::OnDecisionFound(const input::DecisionFound& in) {
  auto arming = armings_.extract(in.question);
  if (arming.empty()) return "";
  if (in.level.ok()) arming.mapped().level = *in.level;
  return OnAnswer(in.level.status(), std::move(arming.mapped()));
}

std::string Admission::OnTermDrawn(const input::TermDrawn& in) {
  if (auto reset = resets_.extract(in.question); !reset.empty()) {
    const absl::Status status = ResetTerm(reset.mapped(), in.term);
    if (!status.ok()) {
      context_.Do(action::AnswerOrder{reset.mapped().token, {.status = status}});
    }
    return "";
  }
  auto arming = armings_.extract(in.question);
  if (arming.empty()) return "";
  if (in.term.ok()) arming.mapped().term = *in.term;
  return OnAnswer(in.term.status(), std::move(arming.mapped()));
}

std::string Admission::OnAnswer(const absl::Status& status, Arming arming) {
  const auto it = hosts_.find(arming.in.host);
  // It has left, or came anew.
  if (it == hosts_.end() || it->second.arming != arming.in.session) return "";
  if (status.ok()) return GoOn(std::move(arming));
  it->second.arming = 0;
  context_.Do(action::Close{arming.in.session, absl::UnavailableError(status.message())});
  return "";
}

void Admission::Reconcile(const input::ActuatorHello& in, const std::optional<std::string>& known) {
  const ActuatorHello& hello = in.hello;
  if (known == hello.decided_level) return;
  const levels::LevelTable& levels = state_.level.table();
  const levels::LevelIndex held = levels.Find(hello.decided_level).value_or(levels.size() - 1);
  const std::string ours = known ? absl::StrCat("which is ", *known, " in this server's history")
                                 : std::string("which this server does not know");
  alerts_.Raise(
      engine::Severity::kCritical,
      absl::StrCat("actuator ", in.host, " holds decision ", ToString(hello.decision_id), " (",
                   levels.name(held), "), ", ours, ": the more restrictive level is ",
                   "adopted; was the store restored from a backup?"));
  // A pardoned epoch would use up all others, and the term is above its own.
  const DecisionId above = hello.decision_id.epoch > kEpochMax
                               ? DecisionId{.term = hello.decision_id.term}
                               : hello.decision_id;
  decider_.Adopt(held, above,
                 absl::StrCat("actuator ", in.host, " holds ", ToString(hello.decision_id), " (",
                              levels.name(held), ")"));
}

void Admission::OnGone(const std::string& host, SessionId session) {
  const auto it = hosts_.find(host);
  if (it != hosts_.end() && it->second.arming == session) it->second.arming = 0;
}

void Admission::CloseUnlisted() {
  for (auto it = hosts_.begin(); it != hosts_.end();) {
    const auto& [name, host] = *it;
    if (actuators_.Lists(name)) {
      ++it;
      continue;
    }
    if (host.arming != 0) {
      context_.Do(action::Close{host.arming, absl::PermissionDeniedError(absl::StrCat(
                                                 "the inventory no longer lists actuator `", name,
                                                 "` of robot `", context_.config.id, "`"))});
    }
    it = hosts_.erase(it);
  }
}

void Admission::CloseAll(const absl::Status& why) {
  for (auto& [name, host] : hosts_) {
    if (host.arming != 0) context_.Do(action::Close{host.arming, why});
    host.arming = 0;
  }
  armings_.clear();
  for (const auto& [question, reset] : resets_) {
    context_.Do(action::AnswerOrder{reset.token, {.status = why}});
  }
  resets_.clear();
}

// --------------------------------------------------------------------------------------- terms

absl::StatusOr<ShownTerm> Admission::TermToReset(const TermResetOrder& order) const {
  const std::string& robot = context_.config.id;
  if (context_.draining) return absl::UnavailableError("the server is stopping");
  if (decider_.holds_back()) {
    // Decided anew, its level would be commanded before it is durable.
    return absl::UnavailableError("a lowering is being recorded; try again");
  }
  RIPS_RETURN_IF_ERROR(Orders::CheckReason(order.reason));
  if (!actuators_.Lists(order.host)) {
    return absl::NotFoundError(absl::StrCat("the inventory lists no actuator `",
                                            absl::CHexEscape(order.host), "` of robot `", robot,
                                            "`"));
  }
  const auto it = hosts_.find(order.host);
  if (it == hosts_.end() || !it->second.refused_term) {
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
                                                      TermRemedy(jump, robot, order.host)));
  }
  return shown;
}

void Admission::OnResetTerm(const input::ResetTerm& in) {
  const absl::StatusOr<ShownTerm> shown = TermToReset(in.order);
  if (!shown.ok()) {
    return context_.Do(action::AnswerOrder{in.token, {.status = shown.status()}});
  }
  context_.Do(action::DrawTerm{.question = ++last_question_,
                               .tenure = context_.tenure,
                               .above = std::max(shown->term(), state_.level.term())});
  resets_.emplace(last_question_, in);
}

absl::Status Admission::ResetTerm(const input::ResetTerm& in,
                                  const absl::StatusOr<uint64_t>& term) {
  const TermResetOrder& order = in.order;
  // While the store answered, the actuator may have come back, or an operator been faster.
  RIPS_ASSIGN_OR_RETURN(const ShownTerm shown, TermToReset(order));
  if (!term.ok()) return absl::UnavailableError(term.status().message());
  const uint64_t before = state_.level.term();
  if (*term <= std::max(shown.term(), before)) {
    return absl::UnavailableError("the terms have moved; try again");
  }
  Host& host = hosts_[order.host];
  host.refused_term.reset();
  host.pardoned_term = shown;
  state_.level.RaiseTerm(*term);
  alerts_.Raise(engine::Severity::kHigh,
                absl::StrCat("operator ", order.operator_name, " lets the server go above term ",
                             shown.term(), " of actuator ", order.host, ", from ", before, " to ",
                             *term, ": ", order.reason));
  const levels::Cause cause{.kind = levels::Cause::Kind::kOperator,
                            .name = order.operator_name,
                            .reason = absl::StrCat("reset-term ", order.host, ": ", order.reason)};
  orders_.Decide(state_.level.Reaffirm(cause, context_.now()), LevelOrder{}, {.token = in.token});
  return absl::OkStatus();
}

}  // namespace rips::pipeline
