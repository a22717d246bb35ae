// A file descriptor that is closed when its owner goes.
#ifndef RIPS_SERVICES_RUNTIME_UNIQUE_FD_H_
#define RIPS_SERVICES_RUNTIME_UNIQUE_FD_H_

#include <unistd.h>

#include <utility>

namespace rips {

// Negative: none, as system calls return it.
class [[nodiscard]] UniqueFd {
 public:
  explicit UniqueFd(int fd = -1) : fd_(fd) {}
  UniqueFd(UniqueFd&& other) noexcept : fd_(other.Release()) {}
  UniqueFd& operator=(UniqueFd&& other) noexcept {
    if (this != &other) {
      Reset();
      fd_ = other.Release();
    }
    return *this;
  }
  ~UniqueFd() { Reset(); }

  int get() const { return fd_; }
  // The caller closes it.
  int Release() { return std::exchange(fd_, -1); }
  void Reset() {
    const int fd = Release();
    if (fd >= 0) close(fd);
  }

 private:
  int fd_;
};

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_UNIQUE_FD_H_
