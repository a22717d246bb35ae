// What a daemon reports to the service manager that started it: the protocol of sd_notify(3),
// datagrams to the socket that NOTIFY_SOCKET names.
//   int main() {
//     ServiceManager manager(ServiceManager::FromEnvironment());  // before threads are started
//     ...
//     manager.Ready();
//     manager.SetStatus("serving 3 robots");
//     while (Work()) manager.Ping();  // on the thread whose progress counts
//     manager.Stopping();
//   }
// libsystemd has the same protocol, but its sd_notify() blocks while the receiver's queue is full.
#ifndef RIPS_SERVICES_RUNTIME_SERVICE_MANAGER_H_
#define RIPS_SERVICES_RUNTIME_SERVICE_MANAGER_H_

#include <sys/socket.h>
#include <sys/un.h>

#include <cstdint>
#include <functional>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/runtime/mutex.h"
#include "services/runtime/unique_fd.h"

namespace rips {

// Any thread. Nothing here blocks or fails: what cannot be sent now goes out before the next
// message, and the newest state takes the place of those before. Without a service manager nothing
// is sent.
class ServiceManager {
 public:
  // Bytes of a status line, after which it is cut.
  static constexpr size_t kStatusBytesMax = 300;
  // How often daemons look whether their status has changed.
  static constexpr absl::Duration kStatusEvery = absl::Seconds(5);
  // Pings in the time after which a silent daemon is ended.
  static constexpr int64_t kPings = 4;

  struct Options {
    // An absolute path, or `@` and an abstract name; empty = there is no service manager. Another
    // kind of address, or one that is too long, is logged and counts as none.
    std::string socket;
    // After so long without a ping the daemon is ended; InfiniteDuration = it is not watched.
    absl::Duration watchdog = absl::InfiniteDuration();
    // CLOCK_MONOTONIC, as the manager's own timer: it stands still while the host is suspended.
    // Null = this host's.
    std::function<int64_t()> monotonic_ns;
  };
  // From NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID, which it removes: child processes must not
  // speak for the daemon. Call it before threads are started. A malformed WATCHDOG_USEC, or one for
  // another process, counts as none.
  static Options FromEnvironment();

  explicit ServiceManager(Options options);
  ServiceManager(const ServiceManager&) = delete;
  ServiceManager& operator=(const ServiceManager&) = delete;

  // The daemon does its work.
  void Ready() ABSL_LOCKS_EXCLUDED(mu_);
  // It reads its configuration anew; Ready follows. No effect before the first Ready.
  void Reloading() ABSL_LOCKS_EXCLUDED(mu_);
  // It ends by itself or as told. No state follows.
  void Stopping() ABSL_LOCKS_EXCLUDED(mu_);
  // One line; it may hold untrusted text, which is escaped. Sent when it has changed.
  void SetStatus(absl::string_view text) ABSL_LOCKS_EXCLUDED(mu_);
  // The work of the daemon advances. Call it as often as you like: kPings in a period are sent.
  void Ping() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void SetState(std::string message) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Sends what waits; false if it still does.
  bool Flush() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool Send(absl::string_view message) const;

  const Options options_;
  // Opened once: a process without a free descriptor still pings.
  UniqueFd fd_;
  sockaddr_un address_ = {};
  socklen_t address_size_ = 0;  // 0 = there is no service manager

  Mutex mu_;
  bool ready_ ABSL_GUARDED_BY(mu_) = false;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  // Empty = it was sent.
  std::string unsent_state_ ABSL_GUARDED_BY(mu_);
  std::string status_ ABSL_GUARDED_BY(mu_);
  std::string sent_status_ ABSL_GUARDED_BY(mu_);
  int64_t next_ping_ns_ ABSL_GUARDED_BY(mu_) = 0;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_SERVICE_MANAGER_H_
