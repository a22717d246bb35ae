#include "policy_server/policy/bundle/bundle_files.h"

#include <fcntl.h>
#include <openssl/evp.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "services/base/check.h"
#include "services/base/status_macros.h"
#include "services/runtime/unique_fd.h"

namespace rips::bundle {
namespace {

absl::Status FromErrno(absl::string_view path) {
  switch (errno) {
    case ENOENT:
      return absl::NotFoundError(absl::StrCat("`", path, "` does not exist"));
    case ELOOP:
      return absl::InvalidArgumentError(absl::StrCat(
          "`", path, "` is or lies behind a symbolic link; put the file itself into the bundle"));
    case ENOTDIR:
      return absl::InvalidArgumentError(
          absl::StrCat("`", path, "` lies behind something that is not a plain directory"));
    default:
      return absl::UnavailableError(absl::StrCat("reading `", path, "`: ", std::strerror(errno)));
  }
}

absl::StatusOr<std::string> ReadAll(int fd, absl::string_view path, size_t bytes_max) {
  std::string text;
  std::array<char, 16384> buffer;
  while (true) {
    const ssize_t got = read(fd, buffer.data(), buffer.size());
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) return FromErrno(path);
    if (got == 0) return text;
    text.append(buffer.data(), static_cast<size_t>(got));
    if (text.size() > bytes_max) {
      return absl::ResourceExhaustedError(
          absl::StrCat("`", path, "` has more than ", bytes_max, " bytes"));
    }
  }
}

}  // namespace

absl::Status CheckBundlePath(absl::string_view path) {
  const auto bad = [&](absl::string_view why) {
    return absl::InvalidArgumentError(absl::StrCat("path `", absl::CHexEscape(path), "` ", why));
  };
  if (path.empty()) return bad("is empty");
  if (path.size() > kBundlePathBytesMax) {
    return bad(absl::StrCat("has ", path.size(), " bytes, limit ", kBundlePathBytesMax));
  }
  if (path.front() == '/') return bad("is absolute; write it relative to the bundle directory");
  for (char c : path) {
    if (!absl::ascii_isalnum(c) && c != '.' && c != '_' && c != '-' && c != '/') {
      return bad("may only contain letters, digits, `.`, `_`, `-` and `/`");
    }
  }
  for (absl::string_view part : absl::StrSplit(path, '/')) {
    if (part == "..") return bad("leaves the bundle directory");
    if (part.empty() || part == ".") return bad("has an empty or `.` component");
  }
  return absl::OkStatus();
}

absl::StatusOr<BundleDirectory> BundleDirectory::Open(const std::string& path) {
  UniqueFd fd(open(path.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (fd.get() < 0) return FromErrno(path);
  return BundleDirectory(std::move(fd));
}

absl::StatusOr<std::string> BundleDirectory::Read(absl::string_view path, size_t bytes_max) const {
  RIPS_RETURN_IF_ERROR(CheckBundlePath(path));
  const std::vector<std::string> parts = absl::StrSplit(path, '/');
  int dir = dup(fd_.get());
  for (size_t i = 0; i + 1 < parts.size() && dir >= 0; ++i) {
    const UniqueFd above(dir);
    dir = openat(above.get(), parts[i].c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
  }
  if (dir < 0) return FromErrno(path);
  const UniqueFd last_dir(dir);
  // Non-blocking, because opening a pipe would wait for a writer.
  const UniqueFd file(openat(last_dir.get(), parts.back().c_str(),
                             O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_NOCTTY | O_CLOEXEC));
  if (file.get() < 0) return FromErrno(path);
  struct stat info = {};
  if (fstat(file.get(), &info) != 0) return FromErrno(path);
  if (!S_ISREG(info.st_mode)) {
    return absl::InvalidArgumentError(absl::StrCat("`", path, "` is not a regular file"));
  }
  return ReadAll(file.get(), path, bytes_max);
}

std::string Sha256Hex(absl::string_view bytes) {
  std::array<unsigned char, 32> digest;
  unsigned int size = 0;
  const int ok =
      EVP_Digest(bytes.data(), bytes.size(), digest.data(), &size, EVP_sha256(), nullptr);
  RIPS_CHECK(ok == 1 && size == digest.size(), "SHA-256 is always available");
  return absl::BytesToHexString(
      absl::string_view(reinterpret_cast<const char*>(digest.data()), digest.size()));
}

}  // namespace rips::bundle
