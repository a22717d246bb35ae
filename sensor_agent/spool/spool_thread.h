// Does the backlog's jobs on disk, in order, on a thread of its own, which alone waits for the
// disk.
#ifndef RIPS_SENSOR_AGENT_SPOOL_SPOOL_THREAD_H_
#define RIPS_SENSOR_AGENT_SPOOL_SPOOL_THREAD_H_

#include <deque>
#include <functional>
#include <memory>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "sensor_agent/outbox/spool_types.h"
#include "sensor_agent/spool/spool.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

// Waits for the disk. Release has no error: what is left of it is found at the next start.
SpoolResult DoJob(Spool& spool, const SpoolJob& job);

class SpoolThread {
 public:
  // `on_result` is called on the thread, once for each job.
  SpoolThread(std::unique_ptr<Spool> spool, std::function<void(SpoolResult)> on_result);
  // Ends the thread as Stop(false), if it runs.
  ~SpoolThread();

  // What former processes left. Once, before the first job; waits for the disk.
  Recovered Recover() { return spool_->Recover(); }
  uint64_t recovered_bytes() const { return spool_->bytes(); }
  // Any thread.
  void Push(SpoolJob job) ABSL_LOCKS_EXCLUDED(mu_);
  // Does the jobs that wait, and ends the thread. `clean`: nothing is lost with this process; if
  // not, the next one says that something is.
  void Stop(bool clean) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Run() ABSL_LOCKS_EXCLUDED(mu_);

  const std::unique_ptr<Spool> spool_;  // the thread's, once there are jobs
  const std::function<void(SpoolResult)> on_result_;
  Mutex mu_;
  CondVar work_;
  std::deque<SpoolJob> jobs_ ABSL_GUARDED_BY(mu_);
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_SPOOL_SPOOL_THREAD_H_
