#ifndef RIPS_SERVICES_RUNTIME_WAKE_FD_H_
#define RIPS_SERVICES_RUNTIME_WAKE_FD_H_

#include <sys/eventfd.h>
#include <unistd.h>

#include <cstdint>

#include "services/base/check.h"
#include "services/runtime/unique_fd.h"

namespace rips {

// Wakes a thread that waits in poll(). Any thread.
class WakeFd {
 public:
  WakeFd() : fd_(eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {
    RIPS_CHECK(fd_.get() >= 0, "no file descriptor for an eventfd");
  }

  // Poll it for POLLIN: readable from Wake to Drain.
  int get() const { return fd_.get(); }
  void Wake() const {
    const uint64_t one = 1;
    // A full counter means that a wake-up is pending already.
    [[maybe_unused]] const ssize_t written = write(fd_.get(), &one, sizeof(one));
  }
  void Drain() const {
    uint64_t drained;
    [[maybe_unused]] const ssize_t got = read(fd_.get(), &drained, sizeof(drained));
  }

 private:
  const UniqueFd fd_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_WAKE_FD_H_
