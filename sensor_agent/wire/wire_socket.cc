#include "sensor_agent/wire/wire_socket.h"

#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <utility>

#include "absl/strings/str_cat.h"
#include "sensor_agent/wire/report_codec.h"
#include "sensor_agent/wire/socket_address.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::wire {

namespace {

constexpr mode_t kMode = 0660;
constexpr int kBacklog = 4;

// Nobody is there: what is left of one who was is removed.
absl::Status ClearPath(const std::string& path) {
  struct stat status = {};
  if (lstat(path.c_str(), &status) != 0) return absl::OkStatus();  // bind tells what else is wrong
  if (!S_ISSOCK(status.st_mode)) {
    return absl::AlreadyExistsError(absl::StrCat("`", path, "` is no socket"));
  }
  if (ConnectLocal(path).ok()) {
    return absl::AlreadyExistsError(
        absl::StrCat("another sensor listens at `", path, "`; give each its own path"));
  }
  if (unlink(path.c_str()) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("removing `", path, "`"));
  }
  return absl::OkStatus();
}

absl::StatusOr<UniqueFd> ListenAt(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const sockaddr_un address, LocalAddress(path));
  RIPS_RETURN_IF_ERROR(ClearPath(path));
  UniqueFd fd(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  const std::string doing = absl::StrCat("listening at `", path, "`");
  // The mode of the descriptor limits that of the path from its first moment; after that it is set
  // whatever the umask.
  if (fd.get() < 0 || fchmod(fd.get(), kMode) != 0 ||
      bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0 ||
      chmod(path.c_str(), kMode) != 0 || listen(fd.get(), kBacklog) != 0) {
    return absl::ErrnoToStatus(errno, doing);
  }
  return fd;
}

bool MayReport(int fd) {
  ucred peer = {};
  socklen_t length = sizeof peer;
  if (getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &length) != 0) return false;
  if (peer.uid == 0 || peer.uid == geteuid()) return true;
  LogWarning("rejected a rips-wire of another user", {{"uid", peer.uid}, {"pid", peer.pid}});
  return false;
}

}  // namespace

WireSocket::WireSocket(WireSocketOptions options, std::function<void()> wake, UniqueFd listener,
                       UniqueFd stop)
    : options_(std::move(options)),
      wake_(std::move(wake)),
      received_({.capacity = options_.reports, .on_full = OnFull::kDropOldest}),
      listener_(std::move(listener)),
      stop_(std::move(stop)),
      buffer_(kReportBytesMax + 1, '\0') {
  thread_ = std::thread([this] { Run(); });
}

absl::StatusOr<std::unique_ptr<WireSocket>> WireSocket::Listen(WireSocketOptions options,
                                                               std::function<void()> wake) {
  RIPS_ASSIGN_OR_RETURN(UniqueFd listener, ListenAt(options.path));
  UniqueFd stop(eventfd(0, EFD_CLOEXEC));
  if (stop.get() < 0) return absl::ErrnoToStatus(errno, "making an eventfd");
  return std::unique_ptr<WireSocket>(
      new WireSocket(std::move(options), std::move(wake), std::move(listener), std::move(stop)));
}

WireSocket::~WireSocket() {
  eventfd_write(stop_.get(), 1);
  thread_.join();
  unlink(options_.path.c_str());
}

void WireSocket::Run() {
  for (;;) {
    // poll passes over negative descriptors.
    std::array<pollfd, 3> fds = {{{.fd = stop_.get(), .events = POLLIN, .revents = 0},
                                  {.fd = listener_.get(), .events = POLLIN, .revents = 0},
                                  {.fd = tap_.get(), .events = POLLIN, .revents = 0}}};
    if (poll(fds.data(), fds.size(), -1) < 0 && errno != EINTR) {
      LogError("waiting for rips-wire failed", {{"errno", errno}});
      return;
    }
    if (fds[0].revents != 0) return;
    if (fds[2].revents != 0 && !ReadReport()) Disconnect();
    if (fds[1].revents != 0) Accept();
  }
}

void WireSocket::Accept() {
  UniqueFd peer(accept4(listener_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
  if (peer.get() < 0 || !MayReport(peer.get())) return;
  if (tap_.get() >= 0) {
    LogWarning("rejected a second rips-wire");
    return;
  }
  tap_ = std::move(peer);
  connected_ = true;
  received_.Push({.connected = true, .report = {}});
  LogInfo("rips-wire connected");
  wake_();
}

bool WireSocket::ReadReport() {
  // One byte of the buffer is more than a report may have.
  const ssize_t bytes = recv(tap_.get(), buffer_.data(), buffer_.size(), 0);
  if (bytes < 0) return errno == EAGAIN || errno == EINTR;
  if (bytes == 0) return false;
  absl::StatusOr<TapReport> report = DecodeReport({buffer_.data(), static_cast<size_t>(bytes)});
  if (!report.ok()) {
    LogError("rejected a report from rips-wire", {{"error", report.status().message()}});
    return false;
  }
  if (report->domain != options_.domain) {
    LogError("rips-wire listens on another domain",
             {{"tap", report->domain}, {"sensor", options_.domain}});
    return false;
  }
  received_.Push({.connected = false, .report = *std::move(report)});
  wake_();
  return true;
}

void WireSocket::Disconnect() {
  tap_.Reset();
  connected_ = false;
  LogWarning("rips-wire disconnected");
  wake_();
}

}  // namespace rips::wire
