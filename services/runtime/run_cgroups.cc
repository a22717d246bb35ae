#include "services/runtime/run_cgroups.h"

#include <dirent.h>
#include <fcntl.h>
#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "services/base/status_macros.h"
#include "services/runtime/real_clock.h"

namespace rips {
namespace {

constexpr char kRunPrefix[] = "run-";
// A program that may make cgroups of its own below the run's is followed this deep.
constexpr int kDepthMax = 16;
constexpr size_t kProcTextMax = 1 << 20;

// Files of the kernel have no size; at most kProcTextMax bytes, empty if it cannot be read.
std::string ReadText(const std::string& path) {
  const UniqueFd file(open(path.c_str(), O_RDONLY | O_CLOEXEC));
  std::string text;
  char buffer[4096];
  while (file.get() >= 0 && text.size() < kProcTextMax) {
    const ssize_t got = read(file.get(), buffer, sizeof(buffer));
    if (got <= 0) break;
    text.append(buffer, static_cast<size_t>(got));
  }
  return text;
}

std::vector<std::string> Subdirectories(const std::string& path) {
  std::vector<std::string> names;
  DIR* directory = opendir(path.c_str());
  if (directory == nullptr) return names;
  while (const dirent* entry = readdir(directory)) {
    if (entry->d_type == DT_DIR && entry->d_name[0] != '.') {
      names.push_back(absl::StrCat(path, "/", entry->d_name));
    }
  }
  closedir(directory);
  return names;
}

int CountBelow(const std::string& path, int depth) {
  const std::string procs = ReadText(path + "/cgroup.procs");
  int count = static_cast<int>(std::count(procs.begin(), procs.end(), '\n'));
  if (depth >= kDepthMax) return count;
  for (const std::string& each : Subdirectories(path)) count += CountBelow(each, depth + 1);
  return count;
}

void RemoveBelow(const std::string& path, int depth) {
  if (rmdir(path.c_str()) == 0 || depth >= kDepthMax) return;
  for (const std::string& each : Subdirectories(path)) RemoveBelow(each, depth + 1);
  rmdir(path.c_str());
}

// What mountinfo writes for a space, a tab, a line feed and a backslash.
std::string Unescape(absl::string_view text) {
  std::string plain;
  for (size_t i = 0; i < text.size(); ++i) {
    const bool octal = text[i] == '\\' && i + 3 < text.size();
    if (!octal) {
      plain.push_back(text[i]);
      continue;
    }
    plain.push_back(static_cast<char>((text[i + 1] - '0') * 64 + (text[i + 2] - '0') * 8 +
                                      (text[i + 3] - '0')));
    i += 3;
  }
  return plain;
}

absl::Status CannotUse(const std::string& path, absl::string_view why) {
  return absl::FailedPreconditionError(absl::StrCat("`", path, "`: ", why));
}

absl::Status CheckUsable(const std::string& parent, const std::string& path) {
  if (access((path + "/cgroup.kill").c_str(), W_OK) != 0) {
    return CannotUse(path, "has no cgroup.kill that we may use; is it cgroup v2 of Linux 5.14?");
  }
  if (access((path + "/cgroup.procs").c_str(), W_OK) != 0 ||
      access((parent + "/cgroup.procs").c_str(), W_OK) != 0) {
    return CannotUse(parent, "is not delegated to us");
  }
  return absl::OkStatus();
}

// Kills and removes the runs below `path`; gives the number of processes.
int Bury(const std::string& path) {
  int count = 0;
  for (const std::string& each : Subdirectories(path)) {
    if (!absl::StartsWith(each, absl::StrCat(path, "/", kRunPrefix))) continue;
    count += CountBelow(each, 0);
    RunCgroup run(each);
    run.Kill();
    const int64_t until_ns = BoottimeAfter(kGoneWait);
    while (run.Populated() && BoottimeNow() < until_ns) poll(nullptr, 0, 2);
  }
  return count;
}

}  // namespace

absl::StatusOr<std::string> FindCgroup(absl::string_view mountinfo, absl::string_view cgroup) {
  absl::string_view own;
  bool found = false;
  for (absl::string_view line : absl::StrSplit(cgroup, '\n')) {
    if (!absl::ConsumePrefix(&line, "0::")) continue;
    own = line;
    found = true;
  }
  if (!found || !absl::StartsWith(own, "/")) {
    return absl::NotFoundError("this process is in no cgroup v2");
  }
  for (const absl::string_view line : absl::StrSplit(mountinfo, '\n')) {
    const std::vector<absl::string_view> halves = absl::StrSplit(line, " - ");
    const std::vector<absl::string_view> fields = absl::StrSplit(halves[0], ' ');
    if (halves.size() != 2 || fields.size() < 6 || !absl::StartsWith(halves[1], "cgroup2 ")) {
      continue;
    }
    // Of the hierarchy only what is below `root` is mounted.
    const std::string root = Unescape(fields[3]);
    absl::string_view below = own;
    if (root != "/" &&
        (!absl::ConsumePrefix(&below, root) || (!below.empty() && !absl::StartsWith(below, "/")))) {
      continue;
    }
    return absl::StrCat(Unescape(fields[4]), below == "/" ? "" : below);
  }
  return absl::NotFoundError("no mount of cgroup v2 shows our cgroup");
}

RunCgroup::~RunCgroup() { RemoveBelow(path_, 0); }

absl::StatusOr<UniqueFd> RunCgroup::OpenProcs() const {
  UniqueFd procs(open((path_ + "/cgroup.procs").c_str(), O_WRONLY | O_CLOEXEC));
  if (procs.get() >= 0) return procs;
  return absl::UnavailableError(
      absl::StrCat("cannot open the cgroup `", path_, "`: ", std::strerror(errno)));
}

int RunCgroup::Count() const { return CountBelow(path_, 0); }

bool RunCgroup::Populated() const {
  return absl::StrContains(ReadText(path_ + "/cgroup.events"), "populated 1");
}

bool RunCgroup::Limit(uint64_t tasks, uint64_t memory_bytes) const {
  const auto set = [this](const char* name, uint64_t value) {
    const UniqueFd file(open(absl::StrCat(path_, "/", name).c_str(), O_WRONLY | O_CLOEXEC));
    const std::string text = absl::StrCat(value);
    return write(file.get(), text.data(), text.size()) == static_cast<ssize_t>(text.size());
  };
  const bool tasks_set = set("pids.max", tasks);
  return set("memory.max", memory_bytes) && tasks_set;
}

void RunCgroup::Kill() const {
  const UniqueFd file(open((path_ + "/cgroup.kill").c_str(), O_WRONLY | O_CLOEXEC));
  [[maybe_unused]] const ssize_t written = write(file.get(), "1", 1);
}

absl::StatusOr<std::unique_ptr<RunCgroups>> RunCgroups::Open(const std::string& parent,
                                                             absl::string_view name,
                                                             int* left_behind) {
  std::string above = parent;
  if (above.empty()) {
    RIPS_ASSIGN_OR_RETURN(
        above, FindCgroup(ReadText("/proc/self/mountinfo"), ReadText("/proc/self/cgroup")));
  }
  const std::string path = absl::StrCat(above, "/", name);
  if (mkdir(path.c_str(), 0755) != 0 && errno != EEXIST) {
    return CannotUse(above, absl::StrCat("cannot make a cgroup below it: ", std::strerror(errno)));
  }
  if (const absl::Status usable = CheckUsable(above, path); !usable.ok()) {
    rmdir(path.c_str());
    return usable;
  }
  *left_behind = Bury(path);
  return std::unique_ptr<RunCgroups>(new RunCgroups(path));
}

RunCgroups::~RunCgroups() { rmdir(path_.c_str()); }

absl::StatusOr<std::unique_ptr<RunCgroup>> RunCgroups::Make() {
  // One that a killed process does not leave keeps its name.
  while (true) {
    std::string path = absl::StrCat(path_, "/", kRunPrefix, next_++);
    if (mkdir(path.c_str(), 0755) == 0) return std::make_unique<RunCgroup>(std::move(path));
    if (errno != EEXIST) {
      return absl::UnavailableError(
          absl::StrCat("cannot make the cgroup `", path, "`: ", std::strerror(errno)));
    }
  }
}

}  // namespace rips
