#include "sensor_agent/wire/socket_address.h"

#include <algorithm>
#include <cerrno>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::wire {

absl::StatusOr<sockaddr_un> LocalAddress(const std::string& path) {
  sockaddr_un address = {};
  address.sun_family = AF_UNIX;
  const size_t bytes_max = sizeof address.sun_path - 1;
  if (path.empty() || path.front() != '/' || path.size() > bytes_max) {
    return absl::InvalidArgumentError(
        absl::StrCat("the path of a socket is absolute and has at most ", bytes_max, " bytes"));
  }
  std::copy(path.begin(), path.end(), address.sun_path);
  return address;
}

absl::StatusOr<UniqueFd> ConnectLocal(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(const sockaddr_un address, LocalAddress(path));
  UniqueFd fd(socket(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
  if (fd.get() < 0) return absl::ErrnoToStatus(errno, "making a local socket");
  if (connect(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0) {
    return fd;
  }
  const std::string doing = absl::StrCat("connecting to `", path, "`");
  const absl::Status failed = absl::ErrnoToStatus(errno, doing);
  if (errno == ENOENT || errno == ECONNREFUSED || errno == EAGAIN) {
    return absl::UnavailableError(failed.message());
  }
  return failed;
}

}  // namespace rips::wire
