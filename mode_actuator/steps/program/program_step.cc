#include "mode_actuator/steps/program/program_step.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>
#include <variant>

#include "absl/base/thread_annotations.h"
#include "absl/strings/str_cat.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {
namespace {

constexpr absl::Duration kDrillPoll = absl::Milliseconds(20);
// At its deadline a program gets SIGTERM, and SIGKILL kTermGrace later; then it must be over.
constexpr absl::Duration kEndGrace = absl::Seconds(2);
// A program that is busy (concurrency limit) is asked for again this often.
constexpr absl::Duration kBusyRetry = absl::Milliseconds(100);

std::string OutputTail(const ProgramResult& ended) {
  const std::string& output = ended.output_tail;
  return output.substr(output.size() - std::min(output.size(), kStepOutputBytesMax));
}

// Where a program's result arrives from the runner's thread.
class ResultSlot {
 public:
  void Set(ProgramResult result) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    result_ = std::move(result);
  }
  std::optional<ProgramResult> Pop() ABSL_LOCKS_EXCLUDED(mu_) {
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
  ProgramAttempt(std::string name, ProgramRequest request, int retries, ProgramRunner* runner,
                 int64_t now_ns)
      : request_(std::move(request)),
        retries_(retries),
        runner_(runner),
        began_ns_(now_ns),
        deadline_ns_(now_ns + absl::ToInt64Nanoseconds(request_.timeout * (1 + retries))) {
    result.step = std::move(name);
  }

  bool Poll(int64_t now_ns) override {
    if (finished_) return true;
    // The runner may hang while it ends the program: waits kEndGrace, as at the deadline.
    if (cancelled_) deadline_ns_ = std::min(deadline_ns_, now_ns);
    if (run_ == 0) {
      if (now_ns >= next_start_ns_) TryStart(now_ns);
    } else if (std::optional<ProgramResult> ended = slot_->Pop()) {
      run_ = 0;
      if (!ended->begun && !cancelled_ && absl::IsResourceExhausted(ended->status) &&
          now_ns < deadline_ns_) {
        next_start_ns_ = now_ns + absl::ToInt64Nanoseconds(kBusyRetry);
      } else if (ended->status.ok() || ++tries_ > retries_) {
        Finish(*ended, now_ns);
      }
    } else if (now_ns >= deadline_ns_ + absl::ToInt64Nanoseconds(kEndGrace)) {
      Finish({.status = absl::DeadlineExceededError("the program runner did not return a result")},
             now_ns);
    }
    return finished_;
  }
  void Cancel() override {
    tries_ = retries_;
    cancelled_ = true;
    if (run_ != 0) {
      runner_->Cancel(run_);
    } else if (!finished_) {
      status = absl::CancelledError("cancelled");
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
    status = ended.status;
    result.ok = status.ok();
    result.detail = ProgramDetail(ended);
    result.output_tail = OutputTail(ended);
    result.took_ms = static_cast<uint32_t>((now_ns - began_ns_) / kNanosPerMilli);
  }

  const ProgramRequest request_;
  const int retries_;
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

class ProgramLevelStep final : public LevelStep {
 public:
  ProgramLevelStep(const Step& spec, bool drill, ProgramRunner* programs, const Clock* clock)
      : LevelStep(spec),
        step_(std::get<ProgramStep>(spec.what)),
        drill_(drill),
        programs_(programs),
        clock_(clock) {}

  std::string Name() const override { return absl::StrCat("program ", step_.name); }
  bool in_order() const override { return false; }

  std::unique_ptr<StepAttempt> Enter(const EnterOptions& options, int64_t now_ns) override {
    ProgramRequest request = {.name = step_.name,
                              .args = step_.args,
                              .timeout = options.timeout,
                              .level_from = options.level_from,
                              .level_to = options.level_to};
    if (step_.level_args) request.args = {options.level_to, options.level_from};
    return std::make_unique<ProgramAttempt>(Name(), std::move(request), options.retries, programs_,
                                            now_ns);
  }
  void Entered(const StepAttempt& attempt) override { done_ = done_ || attempt.result.ok; }
  bool done() const override { return done_; }
  void Forget() override { done_ = false; }

  std::unique_ptr<StepAttempt> Check(const CancelFlag&, int64_t) override { return nullptr; }

  StepResult Drill(const DrillOptions& options) override {
    if (drill_) return RunAsDrill(options);
    return Looked(programs_->Examine(step_.name), "it is there, and safe to run");
  }

 private:
  StepResult RunAsDrill(const DrillOptions& options) const;
  // Until the program is over; nothing if the runner does not say so by `end_ns`.
  std::optional<ProgramResult> Await(uint64_t run, ResultSlot& slot, int64_t end_ns,
                                     const DrillOptions& options) const;
  int64_t NowNs() const { return clock_->Now().boottime_ns; }

  const ProgramStep step_;
  const bool drill_;
  ProgramRunner* const programs_;  // Not owned; outlives this.
  const Clock* const clock_;       // Not owned; outlives this.
  bool done_ = false;
};

StepResult ProgramLevelStep::RunAsDrill(const DrillOptions& options) const {
  const ProgramRequest request = {.name = step_.name,
                                  .args = step_.args,
                                  .timeout = std::min(spec().timeout, options.left),
                                  .drill = true};
  const auto slot = std::make_shared<ResultSlot>();
  const absl::StatusOr<uint64_t> run =
      programs_->Start(request, [slot](ProgramResult ended) { slot->Set(std::move(ended)); });
  if (!run.ok()) return DrillResult(Drilled::kNot, run.status(), "");
  const int64_t end_ns = NowNs() + absl::ToInt64Nanoseconds(request.timeout + kEndGrace);
  const std::optional<ProgramResult> ended = Await(*run, *slot, end_ns, options);
  if (!ended.has_value()) {
    return DrillResult(Drilled::kDone,
                       absl::DeadlineExceededError("the program runner did not return a result"),
                       "");
  }
  StepResult result = DrillResult(ended->begun ? Drilled::kDone : Drilled::kNot, ended->status,
                                  "run as a drill; it exited with 0");
  result.output_tail = OutputTail(*ended);
  return result;
}

std::optional<ProgramResult> ProgramLevelStep::Await(uint64_t run, ResultSlot& slot, int64_t end_ns,
                                                     const DrillOptions& options) const {
  const CancelFlag own;
  const CancelFlag& cancel = *options.cancel;
  bool told = false;
  while (NowNs() < end_ns) {
    if (std::optional<ProgramResult> ended = slot.Pop()) return ended;
    if (cancel.cancelled() && !std::exchange(told, true)) programs_->Cancel(run);
    // What looks at the level, and renews its rules, does not wait for a slow program.
    if (options.between && !told) options.between();
    // A cancelled flag does not sleep, so the wait for the program's end uses a flag of our own.
    (told ? own : cancel).WaitFor(kDrillPoll);
  }
  programs_->Cancel(run);
  return slot.Pop();
}

}  // namespace

std::unique_ptr<LevelStep> MakeProgramStep(const Step& spec, bool drill, ProgramRunner* programs,
                                           const Clock* clock) {
  return std::make_unique<ProgramLevelStep>(spec, drill, programs, clock);
}

}  // namespace rips::actuator
