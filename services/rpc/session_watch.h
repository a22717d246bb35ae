// Ends streams that the library would keep for ever: those whose peer never says hello, and those
// whose certificate has expired.
#ifndef RIPS_SERVICES_RPC_SESSION_WATCH_H_
#define RIPS_SERVICES_RPC_SESSION_WATCH_H_

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "grpcpp/support/status.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

// Any thread.
class SessionWatch {
 public:
  // From a stream's opening to its hello, by CLOCK_BOOTTIME.
  static constexpr absl::Duration kHelloTimeout = absl::Seconds(5);

  struct Session {
    std::atomic<bool> greeted = false;
    int64_t opened_boottime_ns = 0;
    absl::Time not_after;
    // Ends the stream; may be called after it has ended.
    std::function<void(const grpc::Status&)> close;
  };

  // Looks every `interval`, on a thread of its own; InfiniteDuration = only when asked. `clock` is
  // not owned and outlives this.
  explicit SessionWatch(const Clock* clock, absl::Duration interval = absl::Milliseconds(500));
  ~SessionWatch();

  // Watched until the caller drops what is returned. `not_after` is by the wall clock, inclusive.
  std::shared_ptr<Session> Add(absl::Time not_after,
                               std::function<void(const grpc::Status&)> close);
  // Ends what is due now: DEADLINE_EXCEEDED without a hello, UNAUTHENTICATED after `not_after`.
  void Look();
  // Ends every stream with `status`.
  void CloseAll(const grpc::Status& status);

 private:
  void Run();
  std::vector<std::shared_ptr<Session>> Live() ABSL_LOCKS_EXCLUDED(mu_);

  const Clock* clock_;
  const absl::Duration interval_;
  Mutex mu_;
  CondVar stop_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::vector<std::weak_ptr<Session>> sessions_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_SESSION_WATCH_H_
