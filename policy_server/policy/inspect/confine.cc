#include "policy_server/policy/inspect/confine.h"

#include <grp.h>
#include <linux/capability.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

namespace rips::inspect {
namespace {

constexpr int kCapabilitiesMax = 64;
constexpr int kExitFailed = 125;

void Report(char kind, const std::string& text) {
  const std::string line = kind + text + "\n";
  [[maybe_unused]] const ssize_t written = write(kReportFd, line.data(), line.size());
}

void Limit(int what, uint64_t value) {
  rlimit limit = {};
  getrlimit(static_cast<__rlimit_resource>(what), &limit);
  // Never above what is there, which only root may.
  limit.rlim_max = std::min<rlim_t>(limit.rlim_max, value);
  limit.rlim_cur = limit.rlim_max;
  if (setrlimit(static_cast<__rlimit_resource>(what), &limit) != 0) {
    FailJailWithErrno("cannot set a limit");
  }
}

}  // namespace

void ReportMissing(const std::string& what) { Report(kReportMissing, what); }

void FailJail(const std::string& why) {
  Report(kReportFailed, why);
  _exit(kExitFailed);
}

void FailJailWithErrno(const std::string& why) { FailJail(why + ": " + std::strerror(errno)); }

void DropRights(const JailSpec& spec, bool may_drop_groups) {
  // Root gets its capabilities back by exec, unless they are out of bounds.
  for (int capability = 0; capability < kCapabilitiesMax; ++capability) {
    prctl(PR_CAPBSET_DROP, capability, 0, 0, 0);
  }
  if (spec.ids) {
    const auto [uid, gid] = *spec.ids;
    if (may_drop_groups && setgroups(0, nullptr) != 0) {
      FailJailWithErrno("cannot give up its groups");
    }
    if (setresgid(gid, gid, gid) != 0 || setresuid(uid, uid, uid) != 0) {
      FailJailWithErrno("cannot become user " + std::to_string(uid));
    }
  } else if (may_drop_groups) {
    [[maybe_unused]] const int dropped = setgroups(0, nullptr);
  }
  __user_cap_header_struct header = {.version = _LINUX_CAPABILITY_VERSION_3, .pid = 0};
  __user_cap_data_struct none[2] = {};
  if (syscall(SYS_capset, &header, none) != 0) {
    FailJailWithErrno("cannot give up its capabilities");
  }
}

void ApplyLimits(const JailSpec& spec, bool limit_tasks) {
  Limit(RLIMIT_CORE, 0);
  Limit(RLIMIT_FSIZE, 0);
  Limit(RLIMIT_MEMLOCK, 0);
  Limit(RLIMIT_MSGQUEUE, 0);
  if (spec.open_files > 0) Limit(RLIMIT_NOFILE, spec.open_files);
  if (limit_tasks && spec.tasks > 0) Limit(RLIMIT_NPROC, spec.tasks);
  // Last: from now on memory may be short.
  if (spec.address_space_bytes > 0) Limit(RLIMIT_AS, spec.address_space_bytes);
}

void ForbidNewRights() {
  if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) != 0) {
    FailJailWithErrno("cannot forbid new rights");
  }
}

}  // namespace rips::inspect
