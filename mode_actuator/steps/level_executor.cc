#include "mode_actuator/steps/level_executor.h"

#include <algorithm>
#include <cstdint>
#include <memory>
#include <utility>

#include "absl/strings/str_cat.h"
#include "mode_actuator/steps/alarm/alarm_step.h"
#include "mode_actuator/steps/mode_survey.h"

namespace rips::actuator {
namespace {

constexpr absl::Duration kPoll = absl::Milliseconds(20);

// `observed` as in StepAttempt; several stand in a line.
void AddObserved(LevelOutcome& outcome, absl::string_view observed) {
  if (observed.empty()) return;
  absl::StrAppend(&outcome.observed, outcome.observed.empty() ? "" : " ", observed);
}

void AddDetail(LevelOutcome& outcome, const StepResult& result) {
  absl::StrAppend(&outcome.detail, outcome.detail.empty() ? "" : "; ", result.step, ": ",
                  result.detail);
}

std::vector<LevelStep*> Together(const Level::Steps& all) {
  std::vector<LevelStep*> steps;
  for (const std::unique_ptr<LevelStep>& each : all) {
    if (!each->in_order()) steps.push_back(each.get());
  }
  return steps;
}

}  // namespace

LevelOutcome LevelExecutor::Run(const ApplyLevel& job, const CancelFlag& cancel) {
  LevelOutcome outcome;
  outcome.attempt = job.attempt;
  outcome.kind = job.kind;
  if (job.kind == JobKind::kSurvey) {
    Survey(cancel, outcome);
    return outcome;
  }
  const Level* to = FindNamed(levels_, job.to);
  const Level* from = FindNamed(levels_, job.from);
  if (to == nullptr) {
    outcome.detail = absl::StrCat("no level `", job.to, "`");
    return outcome;
  }
  if (job.kind == JobKind::kCheck) {
    Check(*to, cancel, outcome);
    return outcome;
  }
  Progress progress{.options = {.level_from = job.from, .level_to = job.to, .cancel = &cancel},
                    .raise = job.raise,
                    .leave_until_ns = NowNs() + absl::ToInt64Nanoseconds(kLeaveBudget)};
  if (job.kind == JobKind::kOnDrift) {
    OnDrift(*to, progress, outcome);
  } else {
    if (job.kind == JobKind::kEnter) {
      for (const Level& level : levels_) {
        for (const Level::Steps* steps : {&level.enter, &level.leave, &level.on_drift}) {
          for (const std::unique_ptr<LevelStep>& step : *steps) step->Forget();
        }
      }
    }
    // A raise leaves once; what a lowering could not leave it tries again.
    const bool leave = job.kind == JobKind::kEnter || !job.raise;
    if (from != nullptr && from != to && leave) Leave(*from, progress, outcome);
    Enter(*to, progress, outcome);
  }
  outcome.reached = !progress.failed && !cancel.cancelled();
  if (cancel.cancelled()) outcome.detail = "superseded";
  return outcome;
}

void LevelExecutor::Leave(const Level& level, Progress& progress, LevelOutcome& outcome) {
  for (const std::unique_ptr<LevelStep>& step : level.leave) {
    if (progress.stopped || progress.options.cancel->cancelled()) return;
    if (step->done()) continue;
    if (progress.raise) {
      StepResult result = LeaveInTime(*step, progress, outcome);
      if (!result.ok) AddDetail(outcome, result);
      outcome.steps.push_back(std::move(result));
    } else {
      RunAndCount({step.get()}, step->in_order(), progress, outcome);
    }
  }
}

StepResult LevelExecutor::LeaveInTime(LevelStep& step, const Progress& progress,
                                      LevelOutcome& outcome) {
  StepResult result;
  result.step = step.Name();
  const absl::Duration left = absl::Nanoseconds(progress.leave_until_ns - NowNs());
  if (left <= absl::ZeroDuration()) {
    result.detail = "not run: the time for leaving was over";
    return result;
  }
  if (step.opens()) {
    // The next level's own rules take the place of ours; until then there must be no gap.
    result.ok = true;
    result.detail = "not run: a raise opens nothing; what is in force ends with its time";
    return result;
  }
  return std::move(RunSteps({&step}, progress, left, step.in_order(), outcome)[0]);
}

void LevelExecutor::Enter(const Level& level, Progress& progress, LevelOutcome& outcome) {
  const CancelFlag& cancel = *progress.options.cancel;
  for (const std::unique_ptr<LevelStep>& step : level.enter) {
    if (!step->in_order()) continue;
    if (progress.stopped || cancel.cancelled()) {
      progress.failed = true;
      outcome.steps.push_back({.step = step->Name(), .detail = "not run"});
      continue;
    }
    RunAndCount({step.get()}, /*observes=*/true, progress, outcome);
  }
  std::vector<LevelStep*> others = Together(level.enter);
  std::erase_if(others, [](const LevelStep* each) { return each->done(); });
  if (progress.stopped || cancel.cancelled()) {
    if (!others.empty()) progress.failed = true;
    for (const LevelStep* each : others) {
      outcome.steps.push_back({.step = each->Name(), .detail = "not run"});
    }
    return;
  }
  RunAndCount(others, /*observes=*/true, progress, outcome);
}

void LevelExecutor::OnDrift(const Level& level, Progress& progress, LevelOutcome& outcome) {
  const CancelFlag& cancel = *progress.options.cancel;
  progress.raise = true;
  for (const std::unique_ptr<LevelStep>& step : level.on_drift) {
    if (!step->in_order() || progress.stopped || cancel.cancelled()) continue;
    RunAndCount({step.get()}, /*observes=*/true, progress, outcome);
  }
  if (progress.stopped || cancel.cancelled()) return;
  RunAndCount(Together(level.on_drift), /*observes=*/false, progress, outcome);
}

void LevelExecutor::Check(const Level& level, const CancelFlag& cancel, LevelOutcome& outcome) {
  outcome.reached = true;
  for (const std::unique_ptr<LevelStep>& step : level.enter) {
    if (!step->in_order()) continue;
    std::vector<std::unique_ptr<StepAttempt>> checks;
    checks.push_back(step->Check(cancel, NowNs()));
    Drive(checks, absl::InfiniteDuration(), cancel);
    Judge({step.get()}, checks, outcome);
  }
  std::vector<LevelStep*> steps;
  std::vector<std::unique_ptr<StepAttempt>> checks;
  for (LevelStep* step : Together(level.enter)) {
    std::unique_ptr<StepAttempt> check = step->Check(cancel, NowNs());
    if (check == nullptr) continue;
    steps.push_back(step);
    checks.push_back(std::move(check));
  }
  Drive(checks, kAlarmLookTime, cancel);
  Judge(steps, checks, outcome);
}

void LevelExecutor::Judge(const std::vector<LevelStep*>& steps,
                          const std::vector<std::unique_ptr<StepAttempt>>& checks,
                          LevelOutcome& outcome) const {
  for (size_t i = 0; i < steps.size(); ++i) {
    AddObserved(outcome, checks[i]->observed);
    if (checks[i]->dropped.has_value()) outcome.dropped = checks[i]->dropped;
    if (!checks[i]->status.ok()) AddDetail(outcome, checks[i]->result);
    if (steps[i]->Left(*checks[i])) outcome.reached = false;
  }
}

void LevelExecutor::Survey(const CancelFlag& cancel, LevelOutcome& outcome) {
  if (ports_.modes == nullptr) return;
  ModeSurvey survey = SurveyModes(*specs_, *ports_.modes, *ports_.clock, cancel);
  outcome.reached = !survey.level.empty();
  outcome.shown = std::move(survey.level);
  outcome.observed = std::move(survey.observed);
}

std::vector<StepResult> LevelExecutor::RunSteps(const std::vector<LevelStep*>& steps,
                                                const Progress& progress, absl::Duration at_most,
                                                bool observes, LevelOutcome& outcome) {
  std::vector<std::unique_ptr<StepAttempt>> attempts;
  for (LevelStep* step : steps) {
    LevelStep::EnterOptions options = progress.options;
    options.timeout = std::min(step->spec().timeout, at_most);
    // Leaving has no time for them.
    const bool hurried = step->in_order() && at_most != absl::InfiniteDuration();
    options.retries = hurried ? 0 : step->spec().retries;
    attempts.push_back(step->Enter(options, NowNs()));
  }
  Drive(attempts, at_most, *progress.options.cancel);
  std::vector<StepResult> results;
  for (size_t i = 0; i < steps.size(); ++i) {
    steps[i]->Entered(*attempts[i]);
    if (observes) AddObserved(outcome, attempts[i]->observed);
    results.push_back(std::move(attempts[i]->result));
  }
  return results;
}

void LevelExecutor::RunAndCount(const std::vector<LevelStep*>& steps, bool observes,
                                Progress& progress, LevelOutcome& outcome) {
  const std::vector<StepResult> results =
      RunSteps(steps, progress, absl::InfiniteDuration(), observes, outcome);
  for (size_t i = 0; i < steps.size(); ++i) Count(*steps[i], results[i], progress, outcome);
}

void LevelExecutor::Drive(const std::vector<std::unique_ptr<StepAttempt>>& attempts,
                          absl::Duration at_most, const CancelFlag& cancel) const {
  const int64_t cancel_at_ns =
      at_most == absl::InfiniteDuration() ? INT64_MAX : NowNs() + absl::ToInt64Nanoseconds(at_most);
  bool told = false;
  while (true) {
    bool finished = true;
    for (const auto& attempt : attempts) {
      if (!attempt->Poll(NowNs())) finished = false;
    }
    if (finished) break;
    if (!told && (cancel.cancelled() || NowNs() >= cancel_at_ns)) {
      told = true;
      for (const auto& attempt : attempts) attempt->Cancel();
    }
    // A cancelled flag does not sleep, so the wait for jobs that must end uses a flag of its own.
    if (told) {
      CancelFlag().WaitFor(kPoll);
    } else {
      cancel.WaitFor(kPoll);
    }
  }
}

void LevelExecutor::Count(const LevelStep& step, const StepResult& result, Progress& progress,
                          LevelOutcome& outcome) const {
  if (!result.ok) {
    const bool tolerated = !step.in_order() && step.spec().on_failure == OnFailure::kContinue;
    if (!tolerated) progress.failed = true;
    if (step.spec().on_failure == OnFailure::kStop || (!progress.raise && !tolerated)) {
      progress.stopped = true;
    }
    AddDetail(outcome, result);
  }
  outcome.steps.push_back(result);
}

}  // namespace rips::actuator
