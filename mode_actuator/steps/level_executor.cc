#include "mode_actuator/steps/level_executor.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <variant>

#include "absl/base/thread_annotations.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "mode_actuator/steps/alarm/alarm_attempt.h"
#include "mode_actuator/steps/mode_survey.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {
namespace {

constexpr absl::Duration kPoll = absl::Milliseconds(20);
// After its deadline a program is told to end, and killed kTermGrace later; then it must be over.
constexpr absl::Duration kEndGrace = absl::Seconds(2);
// A program that is busy (concurrency limit) is asked for again this often.
constexpr absl::Duration kBusyRetry = absl::Milliseconds(100);

// Where a program's result arrives from the runner's thread.
class ResultSlot {
 public:
  void Set(ProgramResult result) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    result_ = std::move(result);
  }
  std::optional<ProgramResult> Take() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return std::exchange(result_, std::nullopt);
  }

 private:
  Mutex mu_;
  std::optional<ProgramResult> result_ ABSL_GUARDED_BY(mu_);
};

// One program step with its retries, driven by polling.
class ProgramAttempt final : public StepAttempt {
 public:
  // `request` says which levels are left and entered.
  ProgramAttempt(const Step& step, ProgramRunner* runner, ProgramRequest request,
                 absl::Duration timeout, int64_t now_ns)
      : step_(step),
        request_(std::move(request)),
        runner_(runner),
        began_ns_(now_ns),
        deadline_ns_(now_ns + absl::ToInt64Nanoseconds(timeout * (1 + step.retries))) {
    result.step = StepName(step);
    const auto& program = std::get<ProgramStep>(step.what);
    request_.name = program.name;
    request_.args = program.args;
    if (program.level_args) request_.args = {request_.level_to, request_.level_from};
    request_.timeout = timeout;
  }

  bool Poll(int64_t now_ns) override {
    if (finished_) return true;
    // Whoever is told to end it may hang: that is waited for kEndGrace, as at the deadline.
    if (cancelled_) deadline_ns_ = std::min(deadline_ns_, now_ns);
    if (run_ == 0) {
      if (now_ns >= next_start_ns_) TryStart(now_ns);
    } else if (std::optional<ProgramResult> ended = slot_->Take()) {
      run_ = 0;
      if (!ended->begun && !cancelled_ && absl::IsResourceExhausted(ended->status) &&
          now_ns < deadline_ns_) {
        next_start_ns_ = now_ns + absl::ToInt64Nanoseconds(kBusyRetry);
      } else if (ended->status.ok() || ++tries_ > step_.retries) {
        Finish(*ended, now_ns);
      }
    } else if (now_ns >= deadline_ns_ + absl::ToInt64Nanoseconds(kEndGrace)) {
      Finish({.status = absl::DeadlineExceededError("the program runner gave no result")}, now_ns);
    }
    return finished_;
  }
  void Cancel() override {
    tries_ = step_.retries;
    cancelled_ = true;
    if (run_ != 0) {
      runner_->Cancel(run_);
    } else if (!finished_) {
      result.detail = "cancelled";
      finished_ = true;
    }
  }

 private:
  void TryStart(int64_t now_ns) {
    slot_ = std::make_shared<ResultSlot>();
    const absl::StatusOr<uint64_t> run = runner_->Start(
        request_, [slot = slot_](ProgramResult ended) { slot->Set(std::move(ended)); });
    if (run.ok()) {
      run_ = *run;
    } else if (absl::IsResourceExhausted(run.status()) && now_ns < deadline_ns_) {
      next_start_ns_ = now_ns + absl::ToInt64Nanoseconds(kBusyRetry);
    } else {
      Finish({.status = run.status()}, now_ns);
    }
  }
  void Finish(const ProgramResult& ended, int64_t now_ns) {
    finished_ = true;
    result.ok = ended.status.ok();
    result.detail = ProgramDetail(ended);
    const size_t skip =
        ended.output_tail.size() - std::min(ended.output_tail.size(), kStepOutputBytesMax);
    result.output_tail = ended.output_tail.substr(skip);
    result.took_ms = static_cast<uint32_t>((now_ns - began_ns_) / kNanosPerMilli);
  }

  const Step& step_;
  ProgramRequest request_;
  ProgramRunner* const runner_;
  const int64_t began_ns_;
  int64_t deadline_ns_;
  std::shared_ptr<ResultSlot> slot_;
  uint64_t run_ = 0;
  int tries_ = 0;
  int64_t next_start_ns_ = 0;
  bool cancelled_ = false;
  bool finished_ = false;
};

// System modes and firewall steps: one by one, each read back before the next. Programs and alarms
// run at the same time.
bool IsInOrder(const Step& step) {
  return std::holds_alternative<SystemModeStep>(step.what) ||
         std::holds_alternative<FirewallStep>(step.what);
}

bool IsRelease(const Step& step) {
  const auto* firewall = std::get_if<FirewallStep>(&step.what);
  return firewall != nullptr && firewall->kind == FirewallStep::Kind::kRelease;
}

std::string FirewallName(const FirewallStep& step) {
  switch (step.kind) {
    case FirewallStep::Kind::kRules:
      return absl::StrCat("firewall ", step.file);
    case FirewallStep::Kind::kIsolateHosts:
      return absl::StrCat("firewall isolate_host ", absl::StrJoin(step.targets, ","));
    case FirewallStep::Kind::kIsolateParticipants:
      return absl::StrCat("firewall isolate_participant ", absl::StrJoin(step.targets, ","));
    case FirewallStep::Kind::kRelease:
      return "firewall release";
  }
  return "firewall";
}

// `observed` as in StepReading; several stand in a line.
void AddObserved(LevelOutcome& outcome, absl::string_view observed) {
  if (observed.empty()) return;
  absl::StrAppend(&outcome.observed, outcome.observed.empty() ? "" : " ", observed);
}

void AddObserved(LevelOutcome& outcome, const AlarmStep& alarm, const AlarmAttempt& attempt) {
  const std::string word = absl::StrReplaceAll(attempt.observed(), {{" ", "_"}});
  AddObserved(outcome, absl::StrCat(alarm.device, "=", word));
}

StepReading ToReading(const SystemModeStep& mode, const ModeReading& reading) {
  return {.status = reading.status,
          .observed = absl::StrCat(mode.part, "=", reading.observed),
          .note = reading.note};
}

void AddDetail(LevelOutcome& outcome, const StepResult& result) {
  absl::StrAppend(&outcome.detail, outcome.detail.empty() ? "" : "; ", result.step, ": ",
                  result.detail);
}

}  // namespace

std::string StepName(const Step& step) {
  if (const auto* mode = std::get_if<SystemModeStep>(&step.what)) {
    return absl::StrCat("system_mode ", mode->part, "=", mode->mode);
  }
  if (const auto* alarm = std::get_if<AlarmStep>(&step.what)) {
    return absl::StrCat("alarm ", alarm->device, "=", ToString(alarm->state));
  }
  if (const auto* firewall = std::get_if<FirewallStep>(&step.what)) return FirewallName(*firewall);
  return absl::StrCat("program ", std::get<ProgramStep>(step.what).name);
}

const LevelSpec* LevelExecutor::Find(absl::string_view name) const {
  for (const LevelSpec& level : *levels_) {
    if (level.name == name) return &level;
  }
  return nullptr;
}

LevelOutcome LevelExecutor::Run(const ApplyLevel& job, const CancelFlag& cancel) {
  LevelOutcome outcome;
  outcome.attempt = job.attempt;
  outcome.kind = job.kind;
  if (job.kind == JobKind::kSurvey) {
    Survey(cancel, outcome);
    return outcome;
  }
  const LevelSpec* to = Find(job.to);
  const LevelSpec* from = Find(job.from);
  if (to == nullptr) {
    outcome.detail = absl::StrCat("no level `", job.to, "`");
    return outcome;
  }
  if (job.kind == JobKind::kCheck) {
    Check(*to, cancel, outcome);
    return outcome;
  }
  if (job.kind == JobKind::kOnDrift) {
    OnDrift(*to, cancel, outcome);
    return outcome;
  }
  if (job.kind == JobKind::kEnter) {
    overridden_.clear();
    done_.clear();
    misread_alarms_.clear();
  }
  request_ = {.level_from = job.from, .level_to = job.to};
  Progress progress{.raise = job.raise};
  progress.leave_until_ns = NowNs() + absl::ToInt64Nanoseconds(kLeaveBudget);
  // A raise leaves once; what a lowering could not leave it tries again.
  const bool leave = job.kind == JobKind::kEnter || !job.raise;
  if (from != nullptr && from != to && leave) Leave(*from, progress, cancel, outcome);
  Enter(*to, progress, cancel, outcome);
  outcome.reached = !progress.failed && !cancel.cancelled();
  if (cancel.cancelled()) outcome.detail = "superseded";
  return outcome;
}

absl::Duration LevelExecutor::LeaveLeft(const Progress& progress) const {
  if (!progress.raise) return absl::InfiniteDuration();
  return std::max(absl::Nanoseconds(progress.leave_until_ns - NowNs()), absl::ZeroDuration());
}

void LevelExecutor::Leave(const LevelSpec& level, Progress& progress, const CancelFlag& cancel,
                          LevelOutcome& outcome) {
  for (size_t i = 0; i < level.leave.size() && !progress.stopped && !cancel.cancelled(); ++i) {
    const Step& step = level.leave[i];
    const absl::Duration left = LeaveLeft(progress);
    StepResult result;
    result.step = StepName(step);
    if (done_.contains({Phase::kLeave, i})) continue;
    if (left == absl::ZeroDuration()) {
      result.detail = "not run: the time for leaving was over";
    } else if (progress.raise && IsRelease(step)) {
      // The next level's own rules take the place of ours; until then there must be no gap.
      result.ok = true;
      result.detail = "not run: a raise opens nothing; what is in force ends with its time";
    } else if (IsInOrder(step)) {
      result = EnterRead(step, std::min(step.timeout, left), progress.raise ? 0 : step.retries,
                         cancel, outcome);
    } else {
      result = RunTogether(Phase::kLeave, level.leave, {i}, left, cancel, outcome)[0];
    }
    if (progress.raise) {
      if (!result.ok) AddDetail(outcome, result);
      outcome.steps.push_back(std::move(result));
    } else {
      Count(step, result, progress, outcome);
    }
  }
}

void LevelExecutor::Enter(const LevelSpec& level, Progress& progress, const CancelFlag& cancel,
                          LevelOutcome& outcome) {
  std::vector<size_t> others;
  for (size_t i = 0; i < level.enter.size(); ++i) {
    const Step& step = level.enter[i];
    if (!IsInOrder(step)) {
      if (!done_.contains({Phase::kEnter, i})) others.push_back(i);
    } else if (progress.stopped || cancel.cancelled()) {
      progress.failed = true;
      outcome.steps.push_back({.step = StepName(step), .detail = "not run"});
    } else {
      Count(step, EnterRead(step, step.timeout, step.retries, cancel, outcome), progress, outcome);
    }
  }
  if (progress.stopped || cancel.cancelled()) {
    if (!others.empty()) progress.failed = true;
    for (size_t i : others) {
      outcome.steps.push_back({.step = StepName(level.enter[i]), .detail = "not run"});
    }
    return;
  }
  const std::vector<StepResult> results =
      RunTogether(Phase::kEnter, level.enter, others, absl::InfiniteDuration(), cancel, outcome);
  for (size_t k = 0; k < others.size(); ++k) {
    Count(level.enter[others[k]], results[k], progress, outcome);
  }
}

void LevelExecutor::OnDrift(const LevelSpec& level, const CancelFlag& cancel,
                            LevelOutcome& outcome) {
  Progress progress;
  std::vector<size_t> others;
  for (size_t i = 0; i < level.on_drift.size(); ++i) {
    const Step& step = level.on_drift[i];
    if (!IsInOrder(step)) {
      others.push_back(i);
    } else if (!progress.stopped && !cancel.cancelled()) {
      const auto* mode = std::get_if<SystemModeStep>(&step.what);
      if (mode != nullptr) overridden_.erase(mode->part);
      const StepResult result = EnterRead(step, step.timeout, step.retries, cancel, outcome);
      if (mode != nullptr && result.ok) overridden_[mode->part] = mode->mode;
      Count(step, result, progress, outcome);
    }
  }
  if (!progress.stopped && !cancel.cancelled()) {
    const std::vector<StepResult> results = RunTogether(Phase::kOnDrift, level.on_drift, others,
                                                        absl::InfiniteDuration(), cancel, outcome);
    for (size_t k = 0; k < others.size(); ++k) {
      Count(level.on_drift[others[k]], results[k], progress, outcome);
    }
  }
  outcome.reached = !progress.failed && !cancel.cancelled();
  if (cancel.cancelled()) outcome.detail = "superseded";
}

SystemModeStep LevelExecutor::Wanted(const SystemModeStep& step) const {
  const auto overridden = overridden_.find(step.part);
  if (overridden == overridden_.end()) return step;
  return {.part = step.part, .mode = overridden->second};
}

void LevelExecutor::Check(const LevelSpec& level, const CancelFlag& cancel, LevelOutcome& outcome) {
  outcome.reached = true;
  for (const Step& step : level.enter) {
    if (!IsInOrder(step)) continue;
    const StepReading reading = CheckOne(step, cancel);
    AddObserved(outcome, reading.observed);
    if (reading.status.ok()) continue;
    outcome.reached = false;
    AddDetail(outcome, {.step = StepName(step), .detail = std::string(reading.status.message())});
  }
  CheckAlarms(level, cancel, outcome);
}

void LevelExecutor::Survey(const CancelFlag& cancel, LevelOutcome& outcome) {
  if (modes_ == nullptr) return;
  ModeSurvey survey = SurveyModes(*levels_, *modes_, *clock_, cancel);
  outcome.reached = !survey.level.empty();
  outcome.shown = std::move(survey.level);
  outcome.observed = std::move(survey.observed);
}

void LevelExecutor::CheckAlarms(const LevelSpec& level, const CancelFlag& cancel,
                                LevelOutcome& outcome) {
  std::vector<size_t> steps;
  std::vector<std::unique_ptr<AlarmAttempt>> looks;
  std::vector<StepAttempt*> attempts;
  for (size_t i = 0; i < level.enter.size(); ++i) {
    const auto* alarm = std::get_if<AlarmStep>(&level.enter[i].what);
    if (alarm == nullptr) continue;
    steps.push_back(i);
    const AlarmAttempt::Options look = {.order = AlarmOrder::kLook, .timeout = kAlarmLookTime};
    looks.push_back(
        std::make_unique<AlarmAttempt>(*alarm, StepName(level.enter[i]), alarms_, look, NowNs()));
    attempts.push_back(looks.back().get());
  }
  Drive(attempts, kAlarmLookTime, cancel);
  for (size_t k = 0; k < steps.size(); ++k) {
    AddObserved(outcome, std::get<AlarmStep>(level.enter[steps[k]].what), *looks[k]);
    if (looks[k]->status().ok()) {
      misread_alarms_.erase(steps[k]);
      continue;
    }
    AddDetail(outcome, looks[k]->result);
    if (!Tolerates(level, steps[k], looks[k]->status())) outcome.reached = false;
  }
}

bool LevelExecutor::Tolerates(const LevelSpec& level, size_t index,
                              const absl::Status& status) const {
  if (level.enter[index].on_failure != OnFailure::kContinue) return false;
  return !absl::IsFailedPrecondition(status) || misread_alarms_.contains(index);
}

StepReading LevelExecutor::EnterOne(const Step& step, absl::Duration timeout, int retries,
                                    const CancelFlag& cancel) {
  if (const auto* mode = std::get_if<SystemModeStep>(&step.what)) {
    const SystemModeStep wanted = Wanted(*mode);
    return ToReading(wanted, modes_->Enter(wanted.part, wanted.mode, timeout, retries, cancel));
  }
  return runners_.firewall->Enter(step, timeout, retries, cancel);
}

StepReading LevelExecutor::CheckOne(const Step& step, const CancelFlag& cancel) {
  if (const auto* mode = std::get_if<SystemModeStep>(&step.what)) {
    const SystemModeStep wanted = Wanted(*mode);
    return ToReading(wanted, modes_->Check(wanted.part, wanted.mode, cancel));
  }
  return runners_.firewall->Check(step, cancel);
}

StepResult LevelExecutor::EnterRead(const Step& step, absl::Duration timeout, int retries,
                                    const CancelFlag& cancel, LevelOutcome& outcome) {
  const int64_t began_ns = NowNs();
  StepReading reading = EnterOne(step, timeout, retries, cancel);
  AddObserved(outcome, reading.observed);
  StepResult result;
  result.step = StepName(step);
  result.ok = reading.status.ok();
  result.took_ms = static_cast<uint32_t>((NowNs() - began_ns) / kNanosPerMilli);
  result.detail = result.ok ? std::move(reading.note) : std::string(reading.status.message());
  return result;
}

std::vector<StepResult> LevelExecutor::RunTogether(Phase phase, const std::vector<Step>& all,
                                                   const std::vector<size_t>& steps,
                                                   absl::Duration at_most, const CancelFlag& cancel,
                                                   LevelOutcome& outcome) {
  std::vector<std::unique_ptr<StepAttempt>> owned;
  std::vector<StepAttempt*> attempts;
  for (size_t i : steps) {
    const Step& step = all[i];
    const absl::Duration timeout = std::min(step.timeout, at_most);
    if (const auto* alarm = std::get_if<AlarmStep>(&step.what)) {
      const AlarmAttempt::Options options = {.timeout = timeout, .retries = step.retries};
      owned.push_back(
          std::make_unique<AlarmAttempt>(*alarm, StepName(step), alarms_, options, NowNs()));
    } else {
      owned.push_back(
          std::make_unique<ProgramAttempt>(step, programs_, request_, timeout, NowNs()));
    }
    attempts.push_back(owned.back().get());
  }
  Drive(attempts, at_most, cancel);
  std::vector<StepResult> results;
  for (size_t k = 0; k < steps.size(); ++k) {
    const size_t i = steps[k];
    if (const auto* alarm = std::get_if<AlarmStep>(&all[i].what)) {
      // Told again by every retry: that does no harm, and an alarm may have been unplugged.
      const auto& attempt = static_cast<const AlarmAttempt&>(*attempts[k]);
      if (phase == Phase::kEnter) {
        AddObserved(outcome, *alarm, attempt);
        misread_alarms_.erase(i);
        if (absl::IsFailedPrecondition(attempt.status())) misread_alarms_.insert(i);
      }
    } else if (attempts[k]->result.ok) {
      done_.insert({phase, i});
    }
    results.push_back(std::move(attempts[k]->result));
  }
  return results;
}

void LevelExecutor::Drive(const std::vector<StepAttempt*>& attempts, absl::Duration at_most,
                          const CancelFlag& cancel) const {
  const int64_t cancel_at_ns =
      at_most == absl::InfiniteDuration() ? INT64_MAX : NowNs() + absl::ToInt64Nanoseconds(at_most);
  bool told = false;
  while (true) {
    bool finished = true;
    for (StepAttempt* attempt : attempts) {
      if (!attempt->Poll(NowNs())) finished = false;
    }
    if (finished) break;
    if (!told && (cancel.cancelled() || NowNs() >= cancel_at_ns)) {
      told = true;
      for (StepAttempt* attempt : attempts) attempt->Cancel();
    }
    // A cancelled flag does not sleep, so what is told to end is waited for on a flag of our own.
    if (told) {
      CancelFlag().WaitFor(kPoll);
    } else {
      cancel.WaitFor(kPoll);
    }
  }
}

void LevelExecutor::Count(const Step& step, const StepResult& result, Progress& progress,
                          LevelOutcome& outcome) const {
  if (!result.ok) {
    const bool tolerated = !IsInOrder(step) && step.on_failure == OnFailure::kContinue;
    if (!tolerated) progress.failed = true;
    if (step.on_failure == OnFailure::kStop || (!progress.raise && !tolerated)) {
      progress.stopped = true;
    }
    AddDetail(outcome, result);
  }
  outcome.steps.push_back(result);
}

}  // namespace rips::actuator
