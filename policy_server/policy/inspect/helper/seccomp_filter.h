// System calls that inspected payloads must not reach, even if they take over what looks at them.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_SECCOMP_FILTER_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_SECCOMP_FILTER_H_

namespace rips::inspect {

enum class SeccompProfile {
  // Everything but: sockets (a socketpair is allowed), System V and POSIX message queues, io_uring,
  // namespaces and mounts, ptrace and the memory and descriptors of other processes, limits of
  // others, keys, BPF, perf, modules, clocks, reboot. Refused calls fail with EPERM.
  kPlugin,
  // The same, and no signals but to the process itself: where there is no PID namespace.
  kPluginWithoutPidNamespace,
  // Only what a scan needs: read, write, memory, time, exit. Refused calls fail with EPERM.
  kScanner,
};

// For this process and what it becomes and starts, for good. Needs no_new_privs. 0, or an errno.
int ApplySeccomp(SeccompProfile profile);

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_HELPER_SECCOMP_FILTER_H_
