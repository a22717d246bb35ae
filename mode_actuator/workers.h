// The two threads that may block so that the agent's own never does: one carries out level jobs,
// one writes files.
#ifndef RIPS_MODE_ACTUATOR_WORKERS_H_
#define RIPS_MODE_ACTUATOR_WORKERS_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "mode_actuator/cancel_flag.h"
#include "mode_actuator/executor.h"
#include "mode_actuator/procedures.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {

// Runs one job at a time. A new one ends the running one and replaces one that waits.
class LevelWorker {
 public:
  struct Callbacks {
    std::function<void(LevelOutcome)> done;  // once per job that was begun
    // Between jobs that are no emergency, until it gives OK; may be empty.
    std::function<absl::Status()> idle_check;
    std::function<void(const absl::Status&)> idle_checked;
  };

  // `procedures` is not owned and outlives this. Callbacks run on the worker's thread.
  LevelWorker(Procedures* procedures, Callbacks callbacks);
  // Ends the running job and joins.
  ~LevelWorker();

  void Submit(ApplyLevel job) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Loop();

  Procedures* const procedures_;  // Not owned; outlives this.
  const Callbacks callbacks_;
  Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::optional<ApplyLevel> next_ ABSL_GUARDED_BY(mu_);
  std::shared_ptr<CancelFlag> running_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

// Replaces small files, in the order asked.
class FileWorker {
 public:
  struct Task {
    std::string path;
    std::string bytes;
    std::function<void(const absl::Status&)> done;  // on the worker's thread; may be empty
  };

  explicit FileWorker(size_t capacity);
  // Writes what was taken, then joins.
  ~FileWorker();

  // False if `capacity` tasks wait already: `done` is not called.
  bool Submit(Task task) { return queue_.Push(std::move(task)); }

 private:
  void Loop();

  BoundedQueue<Task> queue_;
  std::thread thread_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_WORKERS_H_
