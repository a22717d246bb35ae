// Makes an outage of the store an event: a log line, a gauge and a critical alert when it begins
// (told at once to those who watch, and written first when the disk is back), and their ends.
//
//   state    a write failed or hangs        no failure for kCalmNs
//   calm     the outage begins              -
//   outage   counted                        the outage is over
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_STORE_WATCH_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_STORE_WATCH_H_

#include <cstdint>
#include <functional>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "policy_server/server/shard/server_alerts.h"
#include "policy_server/server/store/committer.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {

// What is counted; a null entry is not.
struct StoreCounts {
  // As Committer::healthy, when it has changed and at the start.
  std::function<void(bool)> healthy;
  std::function<void(uint64_t)> failures;
};

class StoreWatch {
 public:
  static constexpr int64_t kCalmNs = 5 * kNanosPerSecond;

  // Looks every `interval`, on a thread of its own; InfiniteDuration = only when asked. `path` is
  // of the store, for people. Nothing is owned; all outlive this.
  StoreWatch(const store::Committer* committer, ServerAlerts* alerts, const Clock* clock,
             std::string path, StoreCounts counts,
             absl::Duration interval = absl::Milliseconds(500));
  ~StoreWatch();

  // One thread at a time; not beside the thread of its own.
  void Look();

 private:
  void Run();
  void Begin(const absl::Status& health, Instant now);
  void End();

  const store::Committer* committer_;
  ServerAlerts* alerts_;
  const Clock* clock_;
  const std::string path_;
  const StoreCounts counts_;
  const absl::Duration interval_;
  bool outage_ = false;
  bool healthy_ = true;
  int64_t began_ns_ = 0;
  int64_t failed_ns_ = 0;
  uint64_t failures_ = 0;
  uint64_t failures_before_ = 0;
  Mutex mu_;
  CondVar stop_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::thread thread_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_STORE_WATCH_H_
