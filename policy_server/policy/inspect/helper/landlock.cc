#include "policy_server/policy/inspect/helper/landlock.h"

#include <fcntl.h>
#include <glob.h>
#include <linux/landlock.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstdint>
#include <cstring>

#include "services/runtime/unique_fd.h"

namespace rips::inspect {
namespace {

// The header at hand is that of Linux 6.1, and knows ABI 2.
struct Ruleset {
  uint64_t fs = 0;
  uint64_t net = 0;     // ABI 4
  uint64_t scoped = 0;  // ABI 6
};
constexpr uint64_t kTruncate = uint64_t{1} << 14;        // ABI 3
constexpr uint64_t kIoctlDevice = uint64_t{1} << 15;     // ABI 5
constexpr uint64_t kTcp = 3;                             // bind and connect
constexpr uint64_t kAbstractSocketsAndSignals = 3;       // scopes
constexpr uint64_t kFirstAbi = (uint64_t{1} << 13) - 1;  // ABI 1
constexpr uint64_t kReadFile = LANDLOCK_ACCESS_FS_EXECUTE | LANDLOCK_ACCESS_FS_READ_FILE;

Ruleset RulesetFor(long abi) {
  Ruleset set{.fs = kFirstAbi};
  if (abi >= 2) set.fs |= LANDLOCK_ACCESS_FS_REFER;
  if (abi >= 3) set.fs |= kTruncate;
  if (abi >= 4) set.net = kTcp;
  if (abi >= 5) set.fs |= kIoctlDevice;
  if (abi >= 6) set.scoped = kAbstractSocketsAndSignals;
  return set;
}

size_t SizeFor(long abi) {
  return abi >= 6 ? sizeof(Ruleset) : (abi >= 4 ? 2 : 1) * sizeof(uint64_t);
}

// False if there is such a file and it cannot be allowed.
bool Allow(int ruleset, const std::string& path, uint64_t for_file, uint64_t for_directory) {
  const UniqueFd file(open(path.c_str(), O_PATH | O_CLOEXEC));
  struct stat info = {};
  if (file.get() < 0 || fstat(file.get(), &info) != 0) return true;
  landlock_path_beneath_attr rule = {};
  rule.allowed_access = S_ISDIR(info.st_mode) ? for_directory : for_file;
  rule.parent_fd = file.get();
  return syscall(SYS_landlock_add_rule, ruleset, LANDLOCK_RULE_PATH_BENEATH, &rule, 0) == 0;
}

}  // namespace

std::vector<std::string> SystemReadable() {
  std::vector<std::string> paths = {"/usr",
                                    "/bin",
                                    "/sbin",
                                    "/lib",
                                    "/lib32",
                                    "/lib64",
                                    "/etc/ld.so.cache",
                                    "/etc/ld.so.preload",
                                    "/etc/localtime",
                                    "/proc/cpuinfo",
                                    "/proc/meminfo",
                                    "/sys/devices/system/cpu"};
  glob_t found = {};
  if (glob("/etc/python3*", 0, nullptr, &found) == 0) {
    for (size_t i = 0; i < found.gl_pathc; ++i) paths.push_back(found.gl_pathv[i]);
  }
  globfree(&found);
  return paths;
}

std::string ApplyLandlock(const std::vector<std::string>& readable,
                          const std::vector<std::string>& devices) {
  const long abi =
      syscall(SYS_landlock_create_ruleset, nullptr, 0, LANDLOCK_CREATE_RULESET_VERSION);
  if (abi < 1) {
    return "no Landlock: files that the user may read can be read, memory of the user's other "
           "processes opened";
  }
  const Ruleset set = RulesetFor(abi);
  const UniqueFd ruleset(
      static_cast<int>(syscall(SYS_landlock_create_ruleset, &set, SizeFor(abi), 0)));
  bool good = ruleset.get() >= 0;
  for (const std::string& path : readable) {
    good = good && Allow(ruleset.get(), path, kReadFile, kReadFile | LANDLOCK_ACCESS_FS_READ_DIR);
  }
  for (const std::string& path : devices) {
    good = good && Allow(ruleset.get(), path,
                         LANDLOCK_ACCESS_FS_READ_FILE | LANDLOCK_ACCESS_FS_WRITE_FILE, 0);
  }
  good = good && syscall(SYS_landlock_restrict_self, ruleset.get(), 0) == 0;
  return good ? "" : std::string("Landlock does not work: ") + std::strerror(errno);
}

}  // namespace rips::inspect
