#include "services/enrol/key_folder.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <system_error>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/pki/key_request.h"
#include "services/rpc/certificate.h"
#include "services/runtime/atomic_file.h"

namespace rips::enrol {
namespace {

namespace fs = std::filesystem;

constexpr mode_t kFolderMode = 0750;
constexpr mode_t kFileMode = 0640;
constexpr size_t kVersionsKept = 2;
constexpr size_t kFileBytesMax = 64 << 10;

absl::Status FromErrno(absl::string_view doing, const std::string& path) {
  return absl::ErrnoToStatus(errno, absl::StrCat(doing, " `", path, "`"));
}

// Who else can write into the folder can make this process write elsewhere, and with root's powers.
absl::Status CheckSafe(const std::string& path, const struct stat& info) {
  if (!S_ISDIR(info.st_mode)) {
    return absl::FailedPreconditionError(absl::StrCat("`", path, "` is no directory"));
  }
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) == 0 && info.st_uid == geteuid()) {
    return absl::OkStatus();
  }
  return absl::FailedPreconditionError(absl::StrCat(
      "`", path, "` belongs to user ", info.st_uid,
      " or may be written by its group or others; run as its owner, or `chown root` and `chmod "
      "go-w` it"));
}

absl::Status Sync(const std::string& path) {
  const UniqueFd fd(open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (fd.get() < 0 || fsync(fd.get()) != 0) return FromErrno("cannot sync", path);
  return absl::OkStatus();
}

}  // namespace

TlsFiles KeyFolder::tls() const {
  return {.ca = path_ + "/ca.pem", .cert = path_ + "/cert.pem", .key = path_ + "/key.pem"};
}

absl::StatusOr<UniqueFd> KeyFolder::Lock() const {
  const bool made = mkdir(path_.c_str(), kFolderMode) == 0;
  if (!made && errno != EEXIST) return FromErrno("cannot make", path_);
  if (made && chmod(path_.c_str(), kFolderMode) != 0) return FromErrno("cannot open up", path_);
  UniqueFd fd(open(path_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  struct stat info {};
  if (fd.get() < 0 || fstat(fd.get(), &info) != 0) return FromErrno("cannot open", path_);
  RIPS_RETURN_IF_ERROR(CheckSafe(path_, info));
  if (flock(fd.get(), LOCK_EX | LOCK_NB) != 0) {
    return absl::FailedPreconditionError(
        absl::StrCat("another process works in `", path_, "`; wait for it"));
  }
  RemoveLeftovers();
  return fd;
}

absl::StatusOr<std::string> KeyFolder::PendingKey() const {
  const std::string path = path_ + "/pending.pem";
  absl::StatusOr<std::string> pending = ReadFile(path, kFileBytesMax);
  // One that was cut by a power failure is no key: nothing was asked for with it.
  if (pending.ok() && pki::PublicKeyHash(*pending).ok()) return pending;
  RIPS_ASSIGN_OR_RETURN(std::string key, pki::NewKey());
  RIPS_RETURN_IF_ERROR(WriteFileAtomically(path, key, 0600));
  return key;
}

absl::Status KeyFolder::WriteVersion(const std::string& version, const KeyFiles& files) const {
  struct stat owner {};
  if (stat(path_.c_str(), &owner) != 0) return FromErrno("cannot read", path_);
  const std::string versions = path_ + "/versions";
  for (const std::string& folder : {versions, version}) {
    if (mkdir(folder.c_str(), kFolderMode) != 0 && errno != EEXIST) {
      return FromErrno("cannot make", folder);
    }
    // Whatever the umask is: the agent must get through.
    if (lchown(folder.c_str(), owner.st_uid, owner.st_gid) != 0 ||
        chmod(folder.c_str(), kFolderMode) != 0) {
      return FromErrno("cannot give to its owner", folder);
    }
  }
  const std::pair<const char*, const std::string*> all[] = {{"ca.pem", &files.ca_pem},
                                                            {"cert.pem", &files.certificates_pem},
                                                            {"key.pem", &files.key_pem},
                                                            {"server", &files.server}};
  for (const auto& [name, bytes] : all) {
    const std::string path = absl::StrCat(version, "/", name);
    // At first for its owner alone: with its mode, the group could read it before it is theirs.
    RIPS_RETURN_IF_ERROR(WriteFileAtomically(path, *bytes, 0600));
    if (lchown(path.c_str(), owner.st_uid, owner.st_gid) != 0 ||
        chmod(path.c_str(), kFileMode) != 0) {
      return FromErrno("cannot give to its owner", path);
    }
  }
  RIPS_RETURN_IF_ERROR(Sync(version));
  return Sync(versions);
}

absl::Status KeyFolder::Link(const std::string& name, const std::string& target) const {
  const std::string path = absl::StrCat(path_, "/", name);
  const std::string fresh = path + ".new";
  if (unlink(fresh.c_str()) != 0 && errno != ENOENT) return FromErrno("cannot remove", fresh);
  if (symlink(target.c_str(), fresh.c_str()) != 0) return FromErrno("cannot make", fresh);
  if (rename(fresh.c_str(), path.c_str()) != 0) return FromErrno("cannot replace", path);
  return absl::OkStatus();
}

absl::Status KeyFolder::Install(const KeyFiles& files) const {
  const std::string name =
      absl::StrCat(absl::FormatTime("%Y%m%dT%H%M%SZ", absl::Now(), absl::UTCTimeZone()), ".",
                   NewId().substr(0, 8));
  RIPS_RETURN_IF_ERROR(WriteVersion(absl::StrCat(path_, "/versions/", name), files));
  RIPS_RETURN_IF_ERROR(Link("current", "versions/" + name));
  for (const char* file : {"ca.pem", "cert.pem", "key.pem"}) {
    const std::string target = absl::StrCat("current/", file);
    std::error_code error;
    if (fs::read_symlink(absl::StrCat(path_, "/", file), error) == target) continue;
    RIPS_RETURN_IF_ERROR(Link(file, target));
  }
  RIPS_RETURN_IF_ERROR(Sync(path_));
  if (unlink((path_ + "/pending.pem").c_str()) != 0 && errno != ENOENT) {
    return FromErrno("cannot remove", path_ + "/pending.pem");
  }
  RemoveOldVersions();
  return absl::OkStatus();
}

// What a process left that was killed: keys of tokens.
void KeyFolder::RemoveLeftovers() const {
  std::error_code error;
  std::vector<fs::path> left;
  for (const auto& each : fs::directory_iterator(path_, error)) {
    if (absl::StartsWith(each.path().filename().string(), kTokenFolder))
      left.push_back(each.path());
  }
  for (const fs::path& each : left) fs::remove_all(each, error);
}

std::string KeyFolder::Holder() const {
  const absl::StatusOr<std::string> certificate = ReadFile(tls().cert, kFileBytesMax);
  const auto peer = certificate.ok() ? rpc::ReadLeaf(*certificate)
                                     : absl::StatusOr<rpc::Peer>(certificate.status());
  return peer.ok() ? rpc::ToString(peer->identity) : "";
}

bool KeyFolder::HasCertificate() const {
  // Also a link that leads nowhere.
  std::error_code error;
  return fs::symlink_status(tls().cert, error).type() != fs::file_type::not_found ||
         fs::symlink_status(path_ + "/current", error).type() != fs::file_type::not_found;
}

void KeyFolder::RemoveOldVersions() const {
  std::error_code error;
  const fs::path current = fs::read_symlink(path_ + "/current", error).filename();
  std::vector<fs::path> versions;
  for (const auto& each : fs::directory_iterator(path_ + "/versions", error)) {
    if (each.path().filename() != current) versions.push_back(each.path());
  }
  std::sort(versions.begin(), versions.end());
  while (versions.size() >= kVersionsKept) {
    fs::remove_all(versions.front(), error);  // tried again the next time
    versions.erase(versions.begin());
  }
}

std::string KeyFolder::Server() const {
  const absl::StatusOr<std::string> server = ReadFile(path_ + "/current/server", kFileBytesMax);
  return server.ok() ? std::string(absl::StripAsciiWhitespace(*server)) : "";
}

}  // namespace rips::enrol
