#include "services/runtime/key_mode.h"

#include <unistd.h>

#include <algorithm>
#include <filesystem>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace rips {
namespace {

bool IsContainerSecret(const std::string& path) {
  const std::string plain = std::filesystem::path(path).lexically_normal().string();
  return absl::StartsWith(plain, "/run/secrets/") || absl::StartsWith(plain, "/var/run/secrets/");
}

}  // namespace

KeyUser ThisProcess() {
  KeyUser user{.user = geteuid(), .groups = {}};
  const int count = getgroups(0, nullptr);
  user.groups.resize(static_cast<size_t>(std::max(count, 0)));
  const int got = getgroups(count, user.groups.data());
  user.groups.resize(static_cast<size_t>(std::max(got, 0)));
  user.groups.push_back(getegid());
  return user;
}

absl::Status JudgeKeyMode(const std::string& path, const struct stat& info, const KeyUser& user,
                          std::string* warning) {
  if (!S_ISREG(info.st_mode)) return absl::OkStatus();
  const bool others = (info.st_mode & S_IRWXO) != 0;
  const bool group = (info.st_mode & S_IRWXG) != 0;
  const bool own_group = user.user == 0 || std::find(user.groups.begin(), user.groups.end(),
                                                     info.st_gid) != user.groups.end();
  // Neither its owner nor of its group, and closed to others: it cannot read the key, and says that
  // when it tries.
  const bool out_of_reach = info.st_uid != user.user && !own_group;
  if (!others && (!group || own_group || out_of_reach)) return absl::OkStatus();
  const std::string open = absl::StrFormat("private key `%s` is open to other users (mode %04o)",
                                           path, info.st_mode & 07777);
  if (IsContainerSecret(path)) {
    *warning = open;
    return absl::OkStatus();
  }
  // Root checks for the daemon, which may be its owner or of its group.
  std::string remedy = absl::StrCat("chmod o-rwx ", path);
  if (!own_group && info.st_uid == user.user) {
    remedy = absl::StrCat("chmod go-rwx ", path);
  } else if (!own_group) {
    remedy = absl::StrCat("chown ", user.user, " ", path, "; chmod 600 ", path);
  }
  return absl::PermissionDeniedError(absl::StrCat(
      open, "; run `", remedy, "`, and replace the key if one of them may have read it"));
}

absl::Status CheckKeyMode(const std::string& path, std::string* warning) {
  struct stat info = {};
  if (stat(path.c_str(), &info) != 0) return absl::OkStatus();
  return JudgeKeyMode(path, info, ThisProcess(), warning);
}

}  // namespace rips
