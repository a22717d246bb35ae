// The two threads that may block so that the agent's own never does: one carries out level jobs,
// one writes files.
#ifndef RIPS_MODE_ACTUATOR_STEPS_WORKERS_H_
#define RIPS_MODE_ACTUATOR_STEPS_WORKERS_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "mode_actuator/decide/level_controller.h"
#include "mode_actuator/steps/level_executor.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {

// Runs one job at a time. A new one ends the running one and replaces one that waits. Between them
// it may run a drill.
class LevelWorker {
 public:
  struct Callbacks {
    std::function<void(LevelOutcome)> done;  // once per job that was begun
    // Between jobs that are no emergency, until it gives OK; may be empty.
    std::function<absl::Status()> idle_check;
    std::function<void(const absl::Status&)> idle_checked;
  };

  // `executor` is not owned and outlives this. Callbacks run on the worker's thread.
  LevelWorker(LevelExecutor* executor, Callbacks callbacks);
  // Ends the running job and joins.
  ~LevelWorker();

  void Submit(ApplyLevel job) ABSL_LOCKS_EXCLUDED(mu_);

  // A drill; it calls `between` often: what looks at the level is done there, and does not wait for
  // its end. What it returns is called when the next drill can be submitted.
  using DrillTask = std::function<std::function<void()>(const CancelFlag& cancel,
                                                        const std::function<void()>& between)>;
  // Runs `drill` on the worker's thread. False, and nothing happens, if a job that enters a level
  // runs or waits, or another drill does. A job that enters a level ends it, also if it has not
  // begun: then it is run with its flag cancelled, before that job.
  bool SubmitDrill(DrillTask drill) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // What is to be done next; the drill if there is no `job`.
  struct Work {
    std::optional<ApplyLevel> job;
    DrillTask drill;
    std::shared_ptr<CancelFlag> cancel;
  };

  void Loop();
  // None: it stops.
  std::optional<Work> NextWork() ABSL_LOCKS_EXCLUDED(mu_);
  void RunDrill(const DrillTask& drill, const CancelFlag& cancel) ABSL_LOCKS_EXCLUDED(mu_);
  void RunWaitingCheck(const CancelFlag& cancel) ABSL_LOCKS_EXCLUDED(mu_);

  LevelExecutor* const executor_;  // Not owned; outlives this.
  const Callbacks callbacks_;
  Mutex mu_;
  CondVar changed_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::optional<ApplyLevel> next_ ABSL_GUARDED_BY(mu_);
  std::shared_ptr<CancelFlag> running_ ABSL_GUARDED_BY(mu_);
  bool entering_ ABSL_GUARDED_BY(mu_) = false;  // the running job enters a level
  DrillTask drill_ ABSL_GUARDED_BY(mu_);        // that waits
  // Of the drill that waits or runs.
  std::shared_ptr<CancelFlag> drill_cancel_ ABSL_GUARDED_BY(mu_);
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

#endif  // RIPS_MODE_ACTUATOR_STEPS_WORKERS_H_
