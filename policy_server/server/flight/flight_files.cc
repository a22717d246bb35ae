#include "policy_server/server/flight/flight_files.h"

#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "policy_server/policy/recording/reader.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/log.h"

namespace rips::flight {
namespace {

namespace fs = std::filesystem;

constexpr absl::string_view kSuffix = ".rips";
constexpr size_t kIdBytes = 32;
// As `ripsctl` shows ids, and as few of their digits as are taken.
constexpr size_t kShortIdBytes = 8;
constexpr size_t kPrefixBytesMin = 6;

bool IsId(absl::string_view text) {
  return !text.empty() && text.size() <= kIdBytes &&
         std::all_of(text.begin(), text.end(), [](unsigned char c) {
           return absl::ascii_isdigit(c) || (c >= 'a' && c <= 'f');
         });
}

absl::Status MakeDirectory(const std::string& path) {
  if (mkdir(path.c_str(), 0700) == 0 || errno == EEXIST) return absl::OkStatus();
  return absl::ErrnoToStatus(errno, absl::StrCat("cannot make the directory `", path, "`"));
}

std::string NameOf(const recording::RecordedOrigin& origin) {
  return absl::StrCat(absl::Dec(origin.start_unix_ns, absl::kZeroPad19), "-",
                      origin.alerts.front().id.substr(0, kShortIdBytes), kSuffix);
}

}  // namespace

absl::StatusOr<std::unique_ptr<FlightFiles>> FlightFiles::Open(FlightFilesOptions options) {
  RIPS_RETURN_IF_ERROR(MakeDirectory(options.directory));
  std::unique_ptr<FlightFiles> files(new FlightFiles(std::move(options)));
  RIPS_RETURN_IF_ERROR(files->Scan());
  return files;
}

absl::Status FlightFiles::Scan() {
  MutexLock lock(&mu_);
  std::error_code error;
  for (fs::recursive_directory_iterator it(options_.directory, error), end; !error && it != end;
       it.increment(error)) {
    std::error_code gone;
    if (it.depth() != 1 || !it->is_regular_file(gone) || it->is_symlink(gone)) continue;
    const std::string path = it->path().string();
    if (!absl::EndsWith(path, kSuffix)) continue;
    const uint64_t bytes = it->file_size(gone);
    const auto reader = recording::OpenFile(path);
    const recording::RecordedOrigin* origin = reader.ok() ? (*reader)->origin() : nullptr;
    const std::string robot = it->path().parent_path().filename().string();
    if (gone || origin == nullptr || origin->robot != robot) {
      LogWarning("a file among the recordings is none of this robot; it is left alone",
                 {{"file", path}, {"reason", reader.status().message()}});
      continue;
    }
    Add(robot, it->path().filename().string(),
        {.path = path, .bytes = bytes, .alerts = origin->alerts});
  }
  if (error) {
    return absl::UnavailableError(
        absl::StrCat("cannot read `", options_.directory, "`: ", error.message()));
  }
  MakeRoom(0);
  return absl::OkStatus();
}

void FlightFiles::Add(const std::string& robot, const std::string& name, File file) {
  bytes_ += file.bytes;
  for (const recording::RecordedAlert& alert : file.alerts) {
    alerts_.insert_or_assign(alert.id, file.path);
    MutexLock lock(&missing_mu_);
    missing_.erase(alert.id);
  }
  robots_[robot].insert_or_assign(name, std::move(file));
}

void FlightFiles::MakeRoom(uint64_t bytes) {
  while (bytes_ > 0 && bytes_ + bytes > options_.bytes_max) RemoveOne();
}

absl::Status FlightFiles::FreeDisk(uint64_t bytes) {
  struct statvfs space = {};
  if (statvfs(options_.directory.c_str(), &space) != 0) {
    return absl::ErrnoToStatus(errno, absl::StrCat("cannot read `", options_.directory, "`"));
  }
  const uint64_t free_bytes = uint64_t{space.f_bavail} * space.f_frsize;
  const uint64_t needed = options_.free_bytes_min + bytes;
  if (free_bytes >= needed) return absl::OkStatus();
  // Ours make room if that is enough; others' files would fill what they leave.
  const uint64_t missing = needed - free_bytes;
  if (bytes_ < missing) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "the disk of `", options_.directory, "` has ", free_bytes >> 20, " MiB free, and ",
        options_.free_bytes_min >> 20, " MiB are left to the store"));
  }
  const uint64_t until = bytes_ - missing;
  while (bytes_ > until) RemoveOne();
  return absl::OkStatus();
}

void FlightFiles::RemoveOne() {
  const auto bytes_of = [](const Files& files) {
    uint64_t sum = 0;
    for (const auto& [name, file] : files) sum += file.bytes;
    return sum;
  };
  const auto most =
      std::max_element(robots_.begin(), robots_.end(), [&](const auto& one, const auto& other) {
        return bytes_of(one.second) < bytes_of(other.second);
      });
  const auto oldest = most->second.begin();
  const File file = std::move(oldest->second);
  most->second.erase(oldest);
  if (most->second.empty()) robots_.erase(most);
  bytes_ -= file.bytes;
  for (const recording::RecordedAlert& alert : file.alerts) {
    alerts_.erase(alert.id);
    Miss(alert.id, absl::NotFoundError("its recording made room for newer ones"));
  }
  if (unlink(file.path.c_str()) != 0 && errno != ENOENT) {
    LogWarning("cannot remove an old recording", {{"file", file.path}});
  }
}

absl::Status FlightFiles::CheckWritable() const {
  if (access(options_.directory.c_str(), W_OK | X_OK) == 0) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat("cannot write into `", options_.directory, "`: ", std::strerror(errno)));
}

absl::Status FlightFiles::Save(const recording::RecordedOrigin& origin, absl::string_view bytes) {
  if (!IsValidName(origin.robot) || origin.alerts.empty() || !IsId(origin.alerts.front().id)) {
    return absl::InvalidArgumentError("a recording needs a robot and an alert");
  }
  if (bytes.size() > options_.bytes_max) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "it has ", bytes.size(), " bytes; all recordings together may have ", options_.bytes_max));
  }
  const std::string directory = absl::StrCat(options_.directory, "/", origin.robot);
  const std::string name = NameOf(origin);
  const std::string path = absl::StrCat(directory, "/", name);
  RIPS_RETURN_IF_ERROR(MakeDirectory(options_.directory));  // if it was removed
  RIPS_RETURN_IF_ERROR(MakeDirectory(directory));
  {
    MutexLock lock(&mu_);
    MakeRoom(bytes.size());
    RIPS_RETURN_IF_ERROR(FreeDisk(bytes.size()));
  }
  RIPS_RETURN_IF_ERROR(WriteFileAtomically(path, bytes));
  MutexLock lock(&mu_);
  Add(origin.robot, name, {.path = path, .bytes = bytes.size(), .alerts = origin.alerts});
  return absl::OkStatus();
}

void FlightFiles::Miss(const std::string& alert, absl::Status why) {
  MutexLock lock(&missing_mu_);
  if (missing_.insert_or_assign(alert, std::move(why)).second) missing_order_.push_back(alert);
  while (missing_order_.size() > kMissingMax) {
    missing_.erase(missing_order_.front());
    missing_order_.pop_front();
  }
}

void FlightFiles::Expect(const std::string& alert) {
  Miss(alert, absl::FailedPreconditionError("its recording is saved in a few seconds; try again"));
}

void FlightFiles::Lose(const std::string& alert, absl::string_view why) {
  Miss(alert, absl::NotFoundError(absl::StrCat("its recording could not be saved: ", why)));
}

absl::Status FlightFiles::WhyMissing(absl::string_view alert_prefix) const {
  MutexLock lock(&missing_mu_);
  const auto missing = missing_.lower_bound(alert_prefix);
  if (missing != missing_.end() && absl::StartsWith(missing->first, alert_prefix)) {
    return absl::Status(missing->second.code(),
                        absl::StrCat("alert ", missing->first.substr(0, kShortIdBytes), ": ",
                                     missing->second.message()));
  }
  return absl::NotFoundError(
      absl::StrCat("no recording is kept of alert `", alert_prefix,
                   "`: it is not of severity high or critical, too old, or its id is wrong"));
}

absl::StatusOr<std::string> FlightFiles::Find(absl::string_view alert_prefix) const {
  if (!IsId(alert_prefix) || alert_prefix.size() < kPrefixBytesMin) {
    return absl::InvalidArgumentError(absl::StrCat("`", absl::CHexEscape(alert_prefix),
                                                   "` is not an alert's id, nor its first ",
                                                   kPrefixBytesMin, " to ", kIdBytes, " digits"));
  }
  MutexLock lock(&mu_);
  const auto first = alerts_.lower_bound(alert_prefix);
  if (first == alerts_.end() || !absl::StartsWith(first->first, alert_prefix)) {
    return WhyMissing(alert_prefix);
  }
  const auto second = std::next(first);
  if (second != alerts_.end() && absl::StartsWith(second->first, alert_prefix)) {
    return absl::InvalidArgumentError(
        absl::StrCat("the ids of several alerts begin with `", alert_prefix, "`; give more of it"));
  }
  return first->second;
}

uint64_t FlightFiles::bytes() const {
  MutexLock lock(&mu_);
  return bytes_;
}

}  // namespace rips::flight
