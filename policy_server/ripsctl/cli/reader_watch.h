// Notices that what reads our output is gone, also while there is nothing to print.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_READER_WATCH_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_READER_WATCH_H_

#include <atomic>
#include <functional>
#include <thread>

#include "services/runtime/wake_fd.h"

namespace rips::ripsctl {

// While it lives. Without it `ripsctl alert watch | head -1` would go on until the second alert.
class ReaderWatch {
 public:
  // Calls `gone` on a thread of its own, once, when `fd` is a pipe, a socket or a terminal whose
  // other end is closed. `fd` is not owned; -1: there is nothing to watch.
  ReaderWatch(int fd, std::function<void()> on_gone);
  ~ReaderWatch();
  ReaderWatch(const ReaderWatch&) = delete;
  ReaderWatch& operator=(const ReaderWatch&) = delete;

  bool gone() const { return gone_; }

 private:
  const WakeFd stop_;
  std::atomic<bool> gone_ = false;
  std::thread thread_;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_READER_WATCH_H_
