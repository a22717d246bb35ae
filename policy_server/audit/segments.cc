#include "policy_server/audit/segments.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <filesystem>
#include <system_error>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/strip.h"
#include "services/runtime/unique_fd.h"

namespace rips::audit {
namespace {

constexpr size_t kReadBytes = 1 << 20;

}  // namespace

std::string SegmentName(uint64_t number) { return absl::StrFormat("%08d.audit", number); }

uint64_t SegmentNumber(absl::string_view name) {
  uint64_t number = 0;
  absl::string_view digits = name;
  if (!absl::ConsumeSuffix(&digits, ".audit") || !absl::SimpleAtoi(digits, &number)) return 0;
  return SegmentName(number) == name ? number : 0;
}

absl::StatusOr<std::vector<std::string>> SegmentsInDirectory::Names() const {
  std::error_code error;
  std::vector<std::pair<uint64_t, std::string>> found;
  for (std::filesystem::directory_iterator each(directory_, error), end; !error && each != end;
       each.increment(error)) {
    const std::string name = each->path().filename().string();
    if (const uint64_t number = SegmentNumber(name); number > 0) found.emplace_back(number, name);
  }
  if (error) {
    return absl::ErrnoToStatus(error.value(), absl::StrCat("cannot read `", directory_, "`"));
  }
  std::sort(found.begin(), found.end());
  std::vector<std::string> names;
  for (auto& [number, name] : found) names.push_back(std::move(name));
  return names;
}

absl::StatusOr<std::string> SegmentsInDirectory::Read(absl::string_view name,
                                                      uint64_t bytes_max) const {
  const std::string path = absl::StrCat(directory_, "/", name);
  const UniqueFd file(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
  std::string bytes;
  struct stat status {};
  // At once: growing copies, and each page that is new to the process costs a fault.
  if (fstat(file.get(), &status) == 0) {
    bytes.reserve(std::min<uint64_t>(status.st_size + kReadBytes, bytes_max));
  }
  ssize_t got = file.get() < 0 ? -1 : 1;
  while (got > 0 && bytes.size() < bytes_max) {
    const size_t size = bytes.size();
    const size_t wanted = std::min<uint64_t>(kReadBytes, bytes_max - size);
    bytes.resize(size + wanted);
    do {
      got = read(file.get(), bytes.data() + size, wanted);
    } while (got < 0 && errno == EINTR);
    bytes.resize(size + std::max<ssize_t>(got, 0));
  }
  if (got < 0) return absl::ErrnoToStatus(errno, absl::StrCat("cannot read `", path, "`"));
  return bytes;
}

}  // namespace rips::audit
