#include "mode_actuator/steps/workers.h"

#include <utility>

#include "services/runtime/atomic_file.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {

LevelWorker::LevelWorker(LevelExecutor* executor, Callbacks callbacks)
    : executor_(executor), callbacks_(std::move(callbacks)) {
  thread_ = std::thread([this] { Loop(); });
}

LevelWorker::~LevelWorker() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    if (running_ != nullptr) running_->Cancel();
    if (drill_cancel_ != nullptr) drill_cancel_->Cancel();
    changed_.NotifyAll();
  }
  thread_.join();
}

void LevelWorker::Submit(ApplyLevel job) {
  MutexLock lock(&mu_);
  if (drill_cancel_ != nullptr && job.kind != JobKind::kCheck) drill_cancel_->Cancel();
  next_ = std::move(job);
  if (running_ != nullptr) running_->Cancel();
  changed_.NotifyAll();
}

bool LevelWorker::SubmitDrill(DrillTask drill) {
  MutexLock lock(&mu_);
  const bool waits = next_.has_value() && next_->kind != JobKind::kCheck;
  if (stopping_ || waits || entering_ || drill_cancel_ != nullptr) return false;
  drill_ = std::move(drill);
  drill_cancel_ = std::make_shared<CancelFlag>();
  changed_.NotifyAll();
  return true;
}

std::optional<LevelWorker::Work> LevelWorker::NextWork() {
  MutexLock lock(&mu_);
  while (!next_.has_value() && drill_ == nullptr && !stopping_) changed_.Wait(lock);
  if (stopping_) return std::nullopt;
  Work work;
  if (drill_ != nullptr && (!next_.has_value() || drill_cancel_->cancelled())) {
    work.drill = std::exchange(drill_, nullptr);
    work.cancel = drill_cancel_;
    return work;
  }
  work.job = std::exchange(next_, std::nullopt);
  work.cancel = running_ = std::make_shared<CancelFlag>();
  entering_ = work.job->kind != JobKind::kCheck;
  return work;
}

void LevelWorker::RunDrill(const DrillTask& drill, const CancelFlag& cancel) {
  const std::function<void()> over = drill(cancel, [&] { RunWaitingCheck(cancel); });
  {
    MutexLock lock(&mu_);
    drill_cancel_.reset();
  }
  over();
}

void LevelWorker::RunWaitingCheck(const CancelFlag& cancel) {
  ApplyLevel check;
  {
    MutexLock lock(&mu_);
    if (!next_.has_value() || next_->kind != JobKind::kCheck) return;
    check = *std::exchange(next_, std::nullopt);
  }
  callbacks_.done(executor_->Run(check, cancel));
}

void LevelWorker::Loop() {
  bool idle_ok = callbacks_.idle_check == nullptr;
  while (std::optional<Work> work = NextWork()) {
    if (!work->job.has_value()) {
      RunDrill(work->drill, *work->cancel);
      continue;
    }
    LevelOutcome outcome = executor_->Run(*work->job, *work->cancel);
    {
      MutexLock lock(&mu_);
      running_.reset();
      entering_ = false;
    }
    callbacks_.done(std::move(outcome));
    const JobKind kind = work->job->kind;
    if (!idle_ok && kind != JobKind::kEnter && kind != JobKind::kSurvey) {
      const absl::Status status = callbacks_.idle_check();
      idle_ok = status.ok();
      callbacks_.idle_checked(status);
    }
  }
}

FileWorker::FileWorker(size_t capacity) : queue_({.capacity = capacity}) {
  thread_ = std::thread([this] { Loop(); });
}

FileWorker::~FileWorker() {
  queue_.Close();
  thread_.join();
}

void FileWorker::Loop() {
  while (std::optional<Task> task = queue_.Pop(absl::InfiniteDuration())) {
    const absl::Status status = WriteFileAtomically(task->path, task->bytes);
    if (task->done) task->done(status);
  }
}

}  // namespace rips::actuator
