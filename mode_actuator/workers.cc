#include "mode_actuator/workers.h"

#include <utility>

#include "services/runtime/atomic_file.h"

namespace rips::actuator {

LevelWorker::LevelWorker(Procedures* procedures, Callbacks callbacks)
    : procedures_(procedures), callbacks_(std::move(callbacks)) {
  thread_ = std::thread([this] { Loop(); });
}

LevelWorker::~LevelWorker() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    if (running_ != nullptr) running_->Cancel();
    changed_.NotifyAll();
  }
  thread_.join();
}

void LevelWorker::Submit(ApplyLevel job) {
  MutexLock lock(&mu_);
  next_ = std::move(job);
  if (running_ != nullptr) running_->Cancel();
  changed_.NotifyAll();
}

void LevelWorker::Loop() {
  bool idle_ok = callbacks_.idle_check == nullptr;
  while (true) {
    ApplyLevel job;
    auto cancel = std::make_shared<CancelFlag>();
    {
      MutexLock lock(&mu_);
      while (!next_.has_value() && !stopping_) changed_.Wait(lock);
      if (stopping_) return;
      job = *std::exchange(next_, std::nullopt);
      running_ = cancel;
    }
    LevelOutcome outcome = procedures_->Run(job, *cancel);
    {
      MutexLock lock(&mu_);
      running_.reset();
    }
    callbacks_.done(std::move(outcome));
    if (!idle_ok && job.kind != JobKind::kEnter) {
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
