#include "mode_actuator/decide/level_controller.h"

#include <algorithm>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

constexpr int64_t kPersistRetryNs = kNanosPerSecond;
constexpr absl::string_view kStateLost = "state lost";
constexpr absl::string_view kFoundAtStart = "the robot showed it at start";

}  // namespace

absl::StatusOr<LevelController> LevelController::Create(ExecutorOptions options,
                                                        const absl::StatusOr<ActuatorState>& loaded,
                                                        int64_t now_ns) {
  if (options.levels.empty()) return absl::InvalidArgumentError("no levels");
  LevelController controller(std::move(options));
  const ExecutorOptions& o = controller.options_;
  if (o.fail_safe.has_value() && controller.LevelIndex(*o.fail_safe) < 0) {
    return absl::InvalidArgumentError(absl::StrCat(QuoteBytes(*o.fail_safe), " is no level"));
  }
  if (o.fail_safe_after_ns < 0 || o.floor_hold_ns < 0 || o.reconcile_ns <= 0) {
    return absl::InvalidArgumentError("a negative time");
  }
  controller.Load(loaded, now_ns);
  return controller;
}

void LevelController::Load(const absl::StatusOr<ActuatorState>& loaded, int64_t now_ns) {
  lease_end_ns_ = now_ns + kStartGraceNs;
  int decided = -1;
  int effective = -1;
  if (loaded.ok()) {
    highest_term_ = loaded->highest_term;
    decided = loaded->decision_id.none() ? -1 : LevelIndex(loaded->decided);
    effective = LevelIndex(loaded->effective);
  }
  if (loaded.ok() && decided >= 0 && effective >= 0) {
    decision_id_ = loaded->decision_id;
    decided_ = decided;
    effective_ = std::max(effective, decided);
    if (effective_ > decided_) RaiseFloor(effective_, "restart", now_ns);
    return;
  }
  // Nothing is known to be decided: hold the fail-safe level, or what was held, until the server
  // has spoken. With `keep` and nothing to keep, the most restrictive level.
  const int last = static_cast<int>(options_.levels.size()) - 1;
  const int safe = options_.fail_safe.has_value() ? LevelIndex(*options_.fail_safe) : -1;
  effective_ = std::max(effective, safe);
  if (effective_ < 0) effective_ = last;
  RaiseFloor(effective_, std::string(kStateLost), now_ns);
}

int LevelController::LevelIndex(absl::string_view name) const {
  for (size_t i = 0; i < options_.levels.size(); ++i) {
    if (options_.levels[i] == name) return static_cast<int>(i);
  }
  return -1;
}

Actions LevelController::Start(int64_t now_ns) {
  Actions actions;
  const bool may_show_more = target() + 1 < static_cast<int>(options_.levels.size());
  if (options_.survey && may_show_more) StartSurvey(now_ns, actions);
  Reconcile(now_ns, actions);
  Persist(actions);
  return actions;
}

void LevelController::StartSurvey(int64_t now_ns, Actions& actions) {
  job_ = Job{++attempt_, JobKind::kSurvey, target()};
  survey_attempt_ = attempt_;
  recorded_target_ = target();
  survey_end_ns_ = now_ns + kSurveyNsMax;
  actions.push_back(ApplyLevel{.attempt = attempt_, .kind = JobKind::kSurvey});
}

void LevelController::OnSurveyed(const LevelOutcome& outcome) {
  survey_attempt_.reset();
  if (surveying()) {
    job_.reset();
    observed_ = outcome.observed;
  }
  const int shown = LevelIndex(outcome.shown);
  if (shown <= recorded_target_ || shown <= floor_) return;
  floor_ = shown;  // the same start: it does not count as a repeat
  if (floor_reason_ != kStateLost) floor_reason_ = std::string(kFoundAtStart);
}

// --- commands

bool LevelController::AdmitTerm(uint64_t term) {
  if (term < highest_term_) return false;
  if (term > highest_term_) {
    highest_term_ = term;
    live_since_ns_.reset();
    dirty_ = true;
  }
  return true;
}

std::optional<Receipt> LevelController::Judge(const model::Command& command) const {
  const auto& set = std::get<model::SetLevel>(command.what);
  const LevelCommand as_sent{command.id, set.decision_id};
  const auto refuse = [&](Receipt::Stage stage, std::string why) {
    Receipt receipt = MakeReceipt(as_sent, stage);
    receipt.detail = std::move(why);
    return receipt;
  };
  for (const Receipt& receipt : recent_) {
    if (receipt.command_id == command.id) return receipt;
  }
  if (set.decision_id.none() || set.decision_id.term > command.term) {
    return refuse(Receipt::Stage::kRefused, absl::StrCat("decision ", ToString(set.decision_id),
                                                         " does not fit term ", command.term));
  }
  const int to = LevelIndex(set.to);
  if (to < 0) {
    return refuse(Receipt::Stage::kRefused,
                  absl::StrCat("level ", QuoteBytes(set.to), " is not in this actuator's levels"));
  }
  if (set.decision_id == decision_id_ && to != decided_) {
    return refuse(Receipt::Stage::kRefused,
                  absl::StrCat("decision ", ToString(decision_id_), " names ",
                               QuoteBytes(options_.levels[decided_]), " here"));
  }
  if (set.decision_id < decision_id_) {
    return refuse(Receipt::Stage::kRefusedStale,
                  absl::StrCat("decision ", ToString(decision_id_), " is held"));
  }
  const bool names_held = !set.based_on.none() &&
                          (set.based_on == decision_id_ ||
                           (pending_.has_value() && set.based_on == pending_->command.decision_id));
  if (set.decision_id != decision_id_ && to < decided_ && !names_held) {
    return refuse(Receipt::Stage::kRefused,
                  absl::StrCat("lowering to ", QuoteBytes(set.to), " must be based on decision ",
                               ToString(decision_id_)));
  }
  return std::nullopt;
}

Actions LevelController::OnSetLevel(const model::Command& command, int64_t now_ns) {
  const auto& set = std::get<model::SetLevel>(command.what);
  Actions actions;
  if (!AdmitTerm(command.term)) {
    Receipt receipt = MakeReceipt({command.id, set.decision_id}, Receipt::Stage::kRefusedStale);
    receipt.detail = absl::StrCat("term ", command.term, " is below ", highest_term_);
    Send(std::move(receipt), actions);
    return actions;
  }
  if (std::optional<Receipt> answer = Judge(command)) {
    Send(*std::move(answer), actions);
    return actions;
  }
  LevelCommand accepted{command.id, set.decision_id, LevelIndex(set.to), false};
  if (pending_.has_value() && pending_->command.decision_id == set.decision_id) {
    pending_->command.id = command.id;  // sent again while it is being recorded
  } else if (pending_.has_value() && set.decision_id < pending_->command.decision_id) {
    Receipt receipt = MakeReceipt(accepted, Receipt::Stage::kRefusedStale);
    receipt.detail =
        absl::StrCat("decision ", ToString(pending_->command.decision_id), " is being recorded");
    Send(std::move(receipt), actions);
  } else if (set.decision_id == decision_id_) {
    accepted.lowering = command_.has_value() ? command_->lowering : effective_ > decided_;
    command_ = accepted;
    Send(MakeReceipt(accepted, Receipt::Stage::kAcknowledged), actions);
    next_check_ns_ = now_ns;
    Reconcile(now_ns, actions);
  } else if (accepted.to < decided_) {
    accepted.lowering = true;
    if (pending_.has_value()) {
      Send(MakeReceipt(pending_->command, Receipt::Stage::kSuperseded), actions);
    }
    pending_ = PendingLowering{accepted, 0};
    Persist(actions);
    pending_->sequence = sequence_;
  } else {
    Adopt(accepted, actions);
    next_check_ns_ = now_ns;
    Actions apply;
    const uint64_t recorded = sequence_;
    Reconcile(now_ns, apply);
    if (sequence_ == recorded) Persist(apply);
    actions.insert(actions.begin(), apply.begin(), apply.end());  // a raise waits for nothing
  }
  return actions;
}

void LevelController::Adopt(const LevelCommand& command, Actions& actions) {
  if (pending_.has_value() && pending_->command.decision_id != command.decision_id) {
    Send(MakeReceipt(pending_->command, Receipt::Stage::kSuperseded), actions);
  }
  pending_.reset();
  if (command_.has_value() && command_->stage != Receipt::Stage::kVerified) {
    Send(MakeReceipt(*command_, Receipt::Stage::kSuperseded), actions);
  }
  decision_id_ = command.decision_id;
  decided_ = command.to;
  command_ = command;
  Send(MakeReceipt(command, Receipt::Stage::kAcknowledged), actions);
}

Receipt LevelController::MakeReceipt(const LevelCommand& command, Receipt::Stage stage) const {
  Receipt receipt;
  receipt.command_id = command.id;
  receipt.decision_id = command.decision_id;
  receipt.stage = stage;
  receipt.effective_level = options_.levels[effective_];
  return receipt;
}

void LevelController::Send(Receipt receipt, Actions& actions) {
  std::erase_if(recent_, [&](const Receipt& old) { return old.command_id == receipt.command_id; });
  // Only what was taken up is worth remembering: a refusal is found again by judging again.
  if (receipt.stage != Receipt::Stage::kRefused && receipt.stage != Receipt::Stage::kRefusedStale) {
    recent_.push_back(receipt);
    if (recent_.size() > kRecentReceiptsMax) recent_.erase(recent_.begin());
  }
  actions.push_back(SendReceipt{std::move(receipt)});
}

// --- the record

ActuatorState LevelController::StateNow() const {
  ActuatorState state;
  state.decision_id = pending_.has_value() ? pending_->command.decision_id : decision_id_;
  const int decided = pending_.has_value() ? pending_->command.to : decided_;
  if (decided >= 0) state.decided = options_.levels[decided];
  state.effective = options_.levels[effective_];
  state.highest_term = highest_term_;
  return state;
}

void LevelController::Persist(Actions& actions) {
  dirty_ = true;
  actions.push_back(PersistState{++sequence_, StateNow()});
}

Actions LevelController::OnPersisted(uint64_t sequence, const absl::Status& status,
                                     int64_t now_ns) {
  Actions actions;
  settled_sequence_ = std::max(settled_sequence_, sequence);
  if (sequence == sequence_) dirty_ = !status.ok();
  if (!status.ok()) persist_retry_ns_ = now_ns + kPersistRetryNs;
  if (!pending_.has_value() || pending_->sequence != sequence) return actions;
  const LevelCommand command = pending_->command;
  if (!status.ok()) {
    pending_.reset();
    dirty_ = true;  // the disk may hold the lowering all the same
    Receipt receipt = MakeReceipt(command, Receipt::Stage::kFailed);
    receipt.detail = absl::StrCat("the lowering cannot be recorded: ", status.message());
    actions.emplace_back(SendReceipt{std::move(receipt)});  // not remembered: it may be sent again
    return actions;
  }
  Adopt(command, actions);
  next_check_ns_ = now_ns;
  Reconcile(now_ns, actions);
  return actions;
}

// --- lease and floor

bool LevelController::OnLease(const model::LeaseGrant& lease, int64_t now_ns) {
  if (lease.term == 0 || lease.echo_boottime_ns <= 0) return false;
  if (lease.echo_boottime_ns > now_ns || lease.echo_boottime_ns < newest_echo_ns_) return false;
  CheckLease(now_ns);  // a gap that no tick saw is a gap
  if (!AdmitTerm(lease.term)) return false;
  newest_echo_ns_ = lease.echo_boottime_ns;
  lease_term_ = lease.term;
  lease_end_ns_ = lease.echo_boottime_ns + std::min(lease.ttl_ms * kNanosPerMilli, kLeaseNsMax);
  evidence_complete_ = lease.evidence_complete;
  if (LeaseLive(now_ns)) {
    lost_ = false;
    if (!live_since_ns_.has_value()) live_since_ns_ = now_ns;
  }
  return true;
}

void LevelController::CheckLease(int64_t now_ns) {
  if (LeaseLive(now_ns)) return;
  live_since_ns_.reset();
  if (lost_ || now_ns < lease_end_ns_ + options_.fail_safe_after_ns) return;
  lost_ = true;
  if (options_.fail_safe.has_value()) {
    RaiseFloor(LevelIndex(*options_.fail_safe), "lease expired", now_ns);
  }
}

void LevelController::RaiseFloor(int level, std::string reason, int64_t now_ns) {
  floor_raises_ns_.push_back(now_ns);
  while (floor_raises_ns_.size() > kRecentReceiptsMax) floor_raises_ns_.pop_front();
  if (level > floor_ || floor_reason_.empty()) floor_reason_ = std::move(reason);
  floor_ = std::max(floor_, level);
}

int64_t LevelController::FloorHold(int64_t now_ns) const {
  int64_t hold = options_.floor_hold_ns;
  bool first = true;
  for (int64_t raised : floor_raises_ns_) {
    if (now_ns - raised >= kFloorMemoryNs) continue;
    if (!first) hold = std::min(2 * hold, std::max(kFloorHoldNsMax, options_.floor_hold_ns));
    first = false;
  }
  return hold;
}

void LevelController::TryLiftFloor(int64_t now_ns) {
  if (floor_ < 0 || decided_ < 0 || pending_.has_value() || dirty_ || surveying()) return;
  if (!LeaseLive(now_ns) || lease_term_ != highest_term_ || !evidence_complete_) return;
  if (!live_since_ns_.has_value() || now_ns - *live_since_ns_ < FloorHold(now_ns)) return;
  floor_ = -1;
  floor_reason_.clear();
}

// --- bringing the robot there

Actions LevelController::OnTick(int64_t now_ns) {
  Actions actions;
  CheckLease(now_ns);
  if (surveying() && now_ns >= survey_end_ns_) job_.reset();
  TryLiftFloor(now_ns);
  Reconcile(now_ns, actions);
  if (dirty_ && settled_sequence_ == sequence_ && now_ns >= persist_retry_ns_) Persist(actions);
  return actions;
}

void LevelController::Reconcile(int64_t now_ns, Actions& actions) {
  const int goal = target();
  const bool raised = goal > effective_;
  if (raised) {
    effective_ = goal;
    verified_ = false;
  }
  const bool entering = job_.has_value() && job_->kind != JobKind::kCheck;
  if (entering && goal <= job_->level) {
    // Under way, or less restrictive: that waits until this is done.
  } else if (position_ != goal) {
    StartJob(JobKind::kEnter, goal, now_ns, actions);
  } else if (!job_.has_value()) {
    if (const std::optional<JobKind> next = NextJob(goal, now_ns))
      StartJob(*next, goal, now_ns, actions);
  }
  if (raised) Persist(actions);
}

std::optional<JobKind> LevelController::NextJob(int goal, int64_t now_ns) {
  const bool there = verified_ && effective_ == goal;
  if (!there && now_ns >= retry_at_ns_) return JobKind::kRetry;
  // After the level was ordered again: that waits for nothing.
  if (drift_watch_.PopDue(now_ns) && options_.on_drift.contains(options_.levels[goal])) {
    return JobKind::kOnDrift;
  }
  if (there && now_ns >= next_check_ns_) return JobKind::kCheck;
  return std::nullopt;
}

void LevelController::StartJob(JobKind kind, int to, int64_t now_ns, Actions& actions) {
  if (kind == JobKind::kEnter) {
    verified_ = false;
    retry_delay_ns_ = 0;
    drift_watch_.Reset();
    drop_watch_.Enter(now_ns);
    entered_from_ = position_;
    position_ = to;
  }
  job_ = Job{++attempt_, kind, to};
  actions.push_back(ApplyLevel{.attempt = attempt_,
                               .kind = kind,
                               .from = entered_from_ < 0 ? "" : options_.levels[entered_from_],
                               .to = options_.levels[to],
                               .raise = to > entered_from_});
}

Actions LevelController::OnOutcome(const LevelOutcome& outcome, int64_t now_ns) {
  Actions actions;
  if (survey_attempt_ == outcome.attempt) {
    OnSurveyed(outcome);
    Reconcile(now_ns, actions);
    return actions;
  }
  if (!job_.has_value() || job_->attempt != outcome.attempt) return actions;
  const Job job = *job_;
  job_.reset();
  if (job.kind == JobKind::kOnDrift) {
    drift_watch_.Ran(outcome.reached ? absl::string_view() : outcome.detail);
  } else {
    if (!outcome.observed.empty()) observed_ = outcome.observed;
    if (outcome.dropped.has_value()) drop_watch_.Saw(*outcome.dropped, now_ns);
    if (outcome.reached) {
      OnReached(outcome, job.level, now_ns, actions);
    } else {
      OnMissed(outcome, job, now_ns, actions);
    }
  }
  Reconcile(now_ns, actions);
  return actions;
}

void LevelController::OnReached(const LevelOutcome& outcome, int level, int64_t now_ns,
                                Actions& actions) {
  verified_ = true;
  retry_delay_ns_ = 0;
  next_check_ns_ = now_ns + options_.reconcile_ns;
  if (effective_ != level) {
    effective_ = level;
    Persist(actions);
  }
  ReportCommand(level, Receipt::Stage::kVerified, outcome, actions);
}

void LevelController::OnMissed(const LevelOutcome& outcome, const Job& job, int64_t now_ns,
                               Actions& actions) {
  verified_ = false;
  if (job.kind == JobKind::kCheck) {
    ++drifts_;
    drift_watch_.Left(now_ns);
    retry_at_ns_ = now_ns;
    return;
  }
  retry_delay_ns_ = std::clamp(2 * retry_delay_ns_, options_.reconcile_ns,
                               std::max(kRetryNsMax, options_.reconcile_ns));
  retry_at_ns_ = now_ns + retry_delay_ns_;
  ReportCommand(job.level, Receipt::Stage::kFailed, outcome, actions);
}

void LevelController::ReportCommand(int level, Receipt::Stage stage, const LevelOutcome& outcome,
                                    Actions& actions) {
  if (!command_.has_value()) return;
  const bool concerns = command_->lowering ? level == command_->to : level >= command_->to;
  if (!concerns || command_->stage == stage || command_->stage == Receipt::Stage::kVerified) return;
  command_->stage = stage;
  Receipt receipt = MakeReceipt(*command_, stage);
  receipt.steps = outcome.steps;
  receipt.detail = outcome.detail;
  Send(std::move(receipt), actions);
}

ExecutorReport LevelController::Report(int64_t now_ns) const {
  ExecutorReport report;
  report.decision_id = decision_id_;
  if (decided_ >= 0) report.decided = options_.levels[decided_];
  report.effective = options_.levels[effective_];
  report.highest_term = highest_term_;
  report.state_lost = decided_ < 0;
  report.verified = verified_;
  report.observed = observed_;
  if (floor_ >= 0) report.floor = options_.levels[floor_];
  report.floor_reason = floor_reason_;
  report.lease_live = LeaseLive(now_ns);
  report.drifts = drifts_;
  std::string left = drift_watch_.Degraded(report.effective, now_ns);
  if (!left.empty()) report.degraded.push_back(std::move(left));
  return report;
}

}  // namespace rips::actuator
