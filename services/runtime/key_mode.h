// Refuses a private key that other users may use.
#ifndef RIPS_SERVICES_RUNTIME_KEY_MODE_H_
#define RIPS_SERVICES_RUNTIME_KEY_MODE_H_

#include <sys/stat.h>
#include <sys/types.h>

#include <string>
#include <vector>

#include "absl/status/status.h"

namespace rips {

struct KeyUser {
  uid_t user = 0;
  std::vector<gid_t> groups;
};

// The user and the groups of this process.
KeyUser ThisProcess();

// Whether the key file `path`, which stat(2) describes as `info`, is private to `user`:
//
//   bits of                  file                          result
//   the owner alone          any                           OK
//   the group                of a group of `user`          OK
//   the group                any, and `user` is root       OK: root checks for the daemon
//   another group            not owned by `user`           OK: to read it fails
//   others, another group    below /run/secrets            OK, and a `warning`: a container engine
//                                                          mounts it so, for that container alone
//   others, another group    elsewhere                     PermissionDenied
//
// Errors name file, mode and remedy. What is no regular file is OK.
absl::Status JudgeKeyMode(const std::string& path, const struct stat& info, const KeyUser& user,
                          std::string* warning);

// The same of the file itself, for this process; OK if there is none.
absl::Status CheckKeyMode(const std::string& path, std::string* warning);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_KEY_MODE_H_
