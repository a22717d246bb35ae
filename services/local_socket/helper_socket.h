// The Unix socket of a helper process (rips-fw, rips-exec): who may ask, and single packets.
#ifndef RIPS_SERVICES_LOCAL_SOCKET_HELPER_SOCKET_H_
#define RIPS_SERVICES_LOCAL_SOCKET_HELPER_SOCKET_H_

#include <sys/types.h>

#include <cstddef>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {

// A listening SOCK_SEQPACKET socket at `path`, for `user` alone (and root). A socket file that
// no process listens at is replaced; AlreadyExists if one does, FailedPrecondition if
// `path` is something else, Unavailable otherwise.
absl::StatusOr<UniqueFd> ListenAt(const std::string& path, uid_t user);

// The socket systemd has opened for us, as the environment says (sd_listen_fds(3)); none: a
// negative descriptor. InvalidArgument if it is of another kind, or if there are several.
absl::StatusOr<UniqueFd> InheritedListener();

// The inherited one, or our own.
absl::StatusOr<UniqueFd> ListenForHelper(const std::string& path, uid_t user);

// The number of a user named by a name or a number. InvalidArgument, beginning with `key`, if there
// is none.
absl::StatusOr<uid_t> FindUser(const std::string& user, absl::string_view key);

struct Accepted {
  UniqueFd fd;        // does not block; negative: no client waited
  absl::Status peer;  // PermissionDenied if it is neither root's nor `user`'s, as the kernel says
};
Accepted AcceptFrom(int listener, uid_t user);

// A connection to `helper`, `rips-fw`, that does not block. Unavailable: it cannot be reached now.
absl::StatusOr<UniqueFd> ConnectToHelper(const std::string& path, absl::string_view helper);

// One whole packet. Unavailable: none is there now. OutOfRange: the other side has closed. Aborted:
// it closed without having read all we sent; what it said before comes with the next call.
// ResourceExhausted: it was longer than `limit`, and is lost.
absl::StatusOr<std::string> ReceivePacket(int fd, size_t limit);

// Unavailable: there is no room now. Aborted: the other side has closed.
absl::Status SendPacket(int fd, absl::string_view packet);

}  // namespace rips::actuator

#endif  // RIPS_SERVICES_LOCAL_SOCKET_HELPER_SOCKET_H_
