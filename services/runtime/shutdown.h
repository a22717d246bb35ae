// Signals as ordinary calls on one thread, so that nothing runs in a signal handler.
//   int main() {
//     BlockSignals();                                  // before anything starts a thread
//     SignalWaiter signals({{SIGHUP, [&] { server.Reload(); }}});
//     server.Start();
//     signals.WaitForShutdown();                       // SIGTERM or SIGINT
//     server.Stop();
//   }
#ifndef RIPS_SERVICES_RUNTIME_SHUTDOWN_H_
#define RIPS_SERVICES_RUNTIME_SHUTDOWN_H_

#include <functional>
#include <map>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "services/runtime/mutex.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips {

// Blocks SIGTERM, SIGINT, SIGHUP, SIGUSR1 and SIGUSR2 in this thread and those it starts, and
// ignores SIGPIPE. A child process inherits the mask: reset it there (posix_spawnattr_setsigmask).
void BlockSignals();

// At most one per process. A blocked signal without a callback is taken and ignored.
class SignalWaiter {
 public:
  // Called one at a time on the waiter's thread, signal number to callback; repeated signals may
  // be merged into one call. SIGTERM and SIGINT may have one too; WaitForShutdown ends after it.
  using Callbacks = std::map<int, std::function<void()>>;

  explicit SignalWaiter(Callbacks callbacks);
  // Joins the thread. Not from a callback.
  ~SignalWaiter();
  SignalWaiter(const SignalWaiter&) = delete;
  SignalWaiter& operator=(const SignalWaiter&) = delete;

  // Blocks until SIGTERM or SIGINT came (at any time since construction) or RequestShutdown was
  // called. Returns the signal, or 0 for a request.
  int WaitForShutdown() ABSL_LOCKS_EXCLUDED(mu_);
  // The same for at most `timeout`. True if it came.
  bool WaitForShutdown(absl::Duration timeout) ABSL_LOCKS_EXCLUDED(mu_);
  // Ends WaitForShutdown from inside the process. Any thread.
  void RequestShutdown() ABSL_LOCKS_EXCLUDED(mu_) { EndWait(0); }

 private:
  void Run();
  void EndWait(int signal) ABSL_LOCKS_EXCLUDED(mu_);

  const Callbacks callbacks_;
  UniqueFd signal_fd_;
  const WakeFd stop_;
  Mutex mu_;
  CondVar ended_cond_;
  bool ended_ ABSL_GUARDED_BY(mu_) = false;
  int signal_ ABSL_GUARDED_BY(mu_) = 0;
  std::thread thread_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_SHUTDOWN_H_
