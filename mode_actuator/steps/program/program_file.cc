#include "mode_actuator/steps/program/program_file.h"

#include <fcntl.h>
#include <openssl/evp.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <memory>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "services/base/status_macros.h"
#include "services/text/quote.h"

namespace rips::actuator {
namespace {

absl::Status Unsafe(absl::string_view path, absl::string_view why) {
  return absl::PermissionDeniedError(absl::StrCat(QuoteBytes(path), " ", why));
}

absl::Status CheckComponent(const struct stat& info, absl::string_view path, bool last) {
  if (S_ISLNK(info.st_mode)) return Unsafe(path, "is a symbolic link; name its target");
  if (info.st_uid != 0) return Unsafe(path, "is not owned by root");
  if ((info.st_mode & (S_IWGRP | S_IWOTH)) != 0) {
    return Unsafe(path, "can be written by others; chmod go-w");
  }
  if (!last) return S_ISDIR(info.st_mode) ? absl::OkStatus() : Unsafe(path, "is no directory");
  if (!S_ISREG(info.st_mode)) return Unsafe(path, "is no regular file");
  if ((info.st_mode & S_IXUSR) == 0) return Unsafe(path, "is not executable");
  return absl::OkStatus();
}

// The file, opened as a name only.
absl::StatusOr<UniqueFd> Walk(int root_fd, absl::string_view path) {
  if (path.empty() || path.front() != '/') return Unsafe(path, "is not absolute");
  const std::vector<std::string> names = absl::StrSplit(path.substr(1), '/');
  UniqueFd at(openat(root_fd, ".", O_PATH | O_DIRECTORY | O_CLOEXEC));
  struct stat info;
  if (at.get() < 0 || fstat(at.get(), &info) != 0) {
    return absl::UnavailableError("cannot open the root directory");
  }
  RIPS_RETURN_IF_ERROR(CheckComponent(info, "/", false));
  std::string walked;
  for (size_t i = 0; i < names.size(); ++i) {
    if (names[i].empty() || names[i] == "." || names[i] == "..") {
      return Unsafe(path, "has an empty, `.` or `..` component");
    }
    absl::StrAppend(&walked, "/", names[i]);
    UniqueFd next(openat(at.get(), names[i].c_str(), O_PATH | O_NOFOLLOW | O_CLOEXEC));
    if (next.get() < 0 || fstat(next.get(), &info) != 0) {
      return absl::NotFoundError(absl::StrCat(QuoteBytes(walked), ": ", std::strerror(errno)));
    }
    RIPS_RETURN_IF_ERROR(CheckComponent(info, walked, i + 1 == names.size()));
    at = std::move(next);
  }
  return at;
}

}  // namespace

absl::Status CheckProgramPath(int root_fd, absl::string_view path) {
  return Walk(root_fd, path).status();
}

absl::StatusOr<UniqueFd> OpenProgram(int root_fd, absl::string_view path) {
  RIPS_ASSIGN_OR_RETURN(const UniqueFd named, Walk(root_fd, path));
  UniqueFd file(
      open(absl::StrCat("/proc/self/fd/", named.get()).c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY));
  if (file.get() < 0) {
    return Unsafe(path, absl::StrCat("cannot be read: ", std::strerror(errno)));
  }
  return file;
}

absl::Status CheckSha256(int fd, absl::string_view sha256) {
  struct stat info;
  if (fstat(fd, &info) != 0) return absl::UnavailableError("the file cannot be read");
  if (static_cast<size_t>(info.st_size) > kHashedBytesMax) {
    return absl::PermissionDeniedError(absl::StrCat(
        "a file of ", info.st_size, " bytes exceeds limit ", kHashedBytesMax, " of `sha256`"));
  }
  const std::unique_ptr<EVP_MD_CTX, decltype(&EVP_MD_CTX_free)> context(EVP_MD_CTX_new(),
                                                                        &EVP_MD_CTX_free);
  EVP_DigestInit_ex(context.get(), EVP_sha256(), nullptr);
  std::vector<char> buffer(64 << 10);
  for (off_t at = 0; at < info.st_size;) {
    const ssize_t got = pread(fd, buffer.data(), buffer.size(), at);
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) return absl::UnavailableError("the file cannot be read to its end");
    EVP_DigestUpdate(context.get(), buffer.data(), static_cast<size_t>(got));
    at += got;
  }
  unsigned char digest[EVP_MAX_MD_SIZE];
  unsigned size = 0;
  EVP_DigestFinal_ex(context.get(), digest, &size);
  const std::string found =
      absl::BytesToHexString(absl::string_view(reinterpret_cast<const char*>(digest), size));
  if (found == sha256) return absl::OkStatus();
  return absl::PermissionDeniedError(
      absl::StrCat("the file's SHA-256 is ", found, ", not ", sha256));
}

}  // namespace rips::actuator
