#include "services/runtime/service_manager.h"

#include <time.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "services/base/clock.h"
#include "services/runtime/log.h"
#include "services/text/escape.h"
#include "services/text/utf8.h"

namespace rips {
namespace {

constexpr int64_t kNanosPerMicro = 1'000;

int64_t MonotonicNow() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  return now.tv_sec * kNanosPerSecond + now.tv_nsec;
}

std::string TakeVariable(const char* name) {
  const char* value = getenv(name);
  std::string taken = value == nullptr ? "" : value;
  unsetenv(name);
  return taken;
}

// 0 = there is none at `socket`.
socklen_t FillAddress(const std::string& socket, sockaddr_un* address) {
  const bool abstract = socket[0] == '@';
  // A path ends with a NUL, an abstract name begins with one.
  const size_t max = sizeof(address->sun_path) - (abstract ? 0 : 1);
  if ((!abstract && socket[0] != '/') || socket.size() < 2 || socket.size() > max) return 0;
  address->sun_family = AF_UNIX;
  std::memcpy(address->sun_path, socket.data(), socket.size());
  if (abstract) address->sun_path[0] = '\0';
  const size_t size = offsetof(sockaddr_un, sun_path) + socket.size() + (abstract ? 0 : 1);
  return static_cast<socklen_t>(size);
}

// What is valid UTF-8 stays so.
std::string CutBytes(std::string text, size_t max) {
  if (text.size() <= max) return text;
  constexpr absl::string_view kEllipsis = "...";
  size_t end = 0;
  while (true) {
    const size_t next = end + DecodeCodePoint(text, end).length;
    if (next > max - kEllipsis.size()) break;
    end = next;
  }
  return absl::StrCat(text.substr(0, end), kEllipsis);
}

}  // namespace

ServiceManager::Options ServiceManager::FromEnvironment() {
  Options options{.socket = TakeVariable("NOTIFY_SOCKET")};
  const std::string period = TakeVariable("WATCHDOG_USEC");
  const std::string process = TakeVariable("WATCHDOG_PID");
  int64_t micros = 0;
  int64_t pid = 0;
  if (!absl::SimpleAtoi(period, &micros) || micros <= 0) return options;
  if (!process.empty() && (!absl::SimpleAtoi(process, &pid) || pid != getpid())) return options;
  options.watchdog = absl::Microseconds(micros);
  return options;
}

ServiceManager::ServiceManager(Options options) : options_(std::move(options)) {
  if (options_.socket.empty()) return;
  address_size_ = FillAddress(options_.socket, &address_);
  if (address_size_ == 0) {
    LogWarning("cannot notify the service manager: NOTIFY_SOCKET is no usable address",
               {{"address", options_.socket}});
    return;
  }
  fd_ = UniqueFd(socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  if (fd_.get() >= 0) return;
  LogWarning("cannot notify the service manager: no socket", {{"why", std::strerror(errno)}});
  address_size_ = 0;
}

void ServiceManager::Ready() {
  MutexLock lock(&mu_);
  ready_ = true;
  SetState("READY=1");
}

void ServiceManager::Reloading() {
  MutexLock lock(&mu_);
  if (!ready_) return;
  const int64_t now_ns = options_.monotonic_ns ? options_.monotonic_ns() : MonotonicNow();
  SetState(absl::StrCat("RELOADING=1\nMONOTONIC_USEC=", now_ns / kNanosPerMicro));
}

void ServiceManager::Stopping() {
  MutexLock lock(&mu_);
  SetState("STOPPING=1");
  stopping_ = true;
}

void ServiceManager::SetStatus(absl::string_view text) {
  std::string status = CutBytes(EscapeText(text), kStatusBytesMax);
  MutexLock lock(&mu_);
  status_ = std::move(status);
  Flush();
}

void ServiceManager::Ping() {
  MutexLock lock(&mu_);
  if (address_size_ == 0 || options_.watchdog == absl::InfiniteDuration()) return;
  const int64_t now_ns = options_.monotonic_ns ? options_.monotonic_ns() : MonotonicNow();
  if (now_ns < next_ping_ns_ || !Flush() || !Send("WATCHDOG=1")) return;
  next_ping_ns_ = now_ns + absl::ToInt64Nanoseconds(options_.watchdog) / kPings;
}

void ServiceManager::SetState(std::string message) {
  if (stopping_) return;
  unsent_state_ = std::move(message);
  Flush();
}

bool ServiceManager::Flush() {
  if (!unsent_state_.empty()) {
    if (!Send(unsent_state_)) return false;
    unsent_state_.clear();
  }
  if (status_ != sent_status_) {
    if (!Send(absl::StrCat("STATUS=", status_))) return false;
    sent_status_ = status_;
  }
  return true;
}

bool ServiceManager::Send(absl::string_view message) const {
  if (address_size_ == 0) return true;
  return sendto(fd_.get(), message.data(), message.size(), MSG_DONTWAIT | MSG_NOSIGNAL,
                reinterpret_cast<const sockaddr*>(&address_), address_size_) >= 0;
}

}  // namespace rips
