// The actuator's way to a helper process, past a process that poses as one.
//
// What stands at the socket of rips-exec or rips-fw may fail a level's steps, or say that they
// succeeded. So before a word is said:
//
// | what                                    | must be                                             |
// |-----------------------------------------|-----------------------------------------------------|
// | the directory of the socket             | a trusted user's; sticky if others may write to it  |
// | the socket's file                       | a socket, no link, and a trusted user's             |
// | the process that listens (SO_PEERCRED)  | a trusted user's                                    |
//
// Trusted are root (systemd listens for the helper, or it is root's), the user that the helper runs
// as, and our own: another process of that one has our key anyway.
#ifndef RIPS_SERVICES_LOCAL_SOCKET_HELPER_DOOR_H_
#define RIPS_SERVICES_LOCAL_SOCKET_HELPER_DOOR_H_

#include <sys/types.h>

#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/runtime/mutex.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {

// Any thread.
class HelperDoor {
 public:
  // `helper`: `rips-exec`. `run_as`: the user that it runs as, if there is one.
  HelperDoor(std::string path, std::string helper, std::optional<uid_t> run_as)
      : path_(std::move(path)), helper_(std::move(helper)), run_as_(run_as) {}

  // A connection that does not block. Unavailable: it cannot be reached now. PermissionDenied: what
  // is there is not trusted; nothing was sent.
  absl::StatusOr<UniqueFd> Connect() const ABSL_LOCKS_EXCLUDED(mu_);
  // PermissionDenied while what is there is not trusted, as far as the files say without asking,
  // and as the last connection found. Ok if there is nothing.
  absl::Status Check() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  bool Trusts(uid_t user) const;
  absl::Status CheckFiles() const;
  absl::Status CheckPeer(int fd) const;
  absl::Status NotTrusted(absl::string_view why) const;

  const std::string path_;
  const std::string helper_;
  const std::optional<uid_t> run_as_;
  mutable Mutex mu_;
  // Of the last connection.
  mutable absl::Status found_ ABSL_GUARDED_BY(mu_);
};

// The user of a helper: `configured`, a name or a number; if that is empty, the user that packages
// make for it, if there is one. InvalidArgument, beginning with `key`, if the configured one does
// not exist.
absl::StatusOr<std::optional<uid_t>> FindHelperUser(const std::string& configured,
                                                    const std::string& packaged,
                                                    absl::string_view key);

}  // namespace rips::actuator

#endif  // RIPS_SERVICES_LOCAL_SOCKET_HELPER_DOOR_H_
