// Ends streams that the library would keep for ever: those whose peer never says hello, and those
// whose certificate has expired.
#ifndef RIPS_SERVICES_RPC_SESSION_WATCH_H_
#define RIPS_SERVICES_RPC_SESSION_WATCH_H_

#include <atomic>
#include <functional>
#include <memory>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "grpcpp/support/status.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

class SessionWatch {
 public:
  struct Session {
    std::atomic<bool> greeted = false;
    absl::Time opened;
    absl::Time not_after;
    // Ends the stream; may be called after it has ended.
    std::function<void(const grpc::Status&)> close;
  };

  // Looks every `interval`, on a thread of its own.
  explicit SessionWatch(absl::Duration hello_timeout = absl::Seconds(5),
                        absl::Duration interval = absl::Milliseconds(500));
  ~SessionWatch();

  // Watched until the caller drops what is returned. Any thread.
  std::shared_ptr<Session> Add(absl::Time not_after,
                               std::function<void(const grpc::Status&)> close);
  // Ends every stream with `status`.
  void CloseAll(const grpc::Status& status);

 private:
  void Run();
  std::vector<std::shared_ptr<Session>> Live() ABSL_LOCKS_EXCLUDED(mu_);

  const absl::Duration hello_timeout_;
  const absl::Duration interval_;
  Mutex mu_;
  CondVar stop_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::vector<std::weak_ptr<Session>> sessions_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_SESSION_WATCH_H_
