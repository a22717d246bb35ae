#include "policy_server/policy/inspect/helper/seccomp_filter.h"

#include <linux/audit.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <vector>

namespace rips::inspect {
namespace {

#if defined(__x86_64__)
constexpr uint32_t kArch = AUDIT_ARCH_X86_64;
#elif defined(__aarch64__)
constexpr uint32_t kArch = AUDIT_ARCH_AARCH64;
#else
#error "name the audit architecture of this processor"
#endif
// x86-64 only: the same calls by other numbers.
constexpr uint32_t kX32Bit = 0x40000000;
// CLONE_NEWNS, NEWCGROUP, NEWUTS, NEWIPC, NEWUSER, NEWPID, NEWNET.
constexpr uint32_t kNamespaces = 0x7e020000;
constexpr uint32_t kRefuse = SECCOMP_RET_ERRNO | EPERM;

constexpr int kNeverForPlugins[] = {
    __NR_socket, __NR_accept, __NR_accept4, __NR_connect, __NR_bind, __NR_listen,
    // Would do what the calls above are refused.
    __NR_io_uring_setup, __NR_io_uring_enter, __NR_io_uring_register,
    // Other processes.
    __NR_ptrace, __NR_process_vm_readv, __NR_process_vm_writev, __NR_process_madvise, __NR_kcmp,
    __NR_pidfd_getfd, __NR_move_pages, __NR_migrate_pages, __NR_setpriority, __NR_ioprio_set,
    __NR_sched_setscheduler, __NR_sched_setattr, __NR_sched_setparam,
    // What processes share without files.
    __NR_shmget, __NR_shmat, __NR_shmctl, __NR_semget, __NR_semop, __NR_semtimedop, __NR_semctl,
    __NR_msgget, __NR_msgsnd, __NR_msgrcv, __NR_msgctl, __NR_mq_open, __NR_mq_unlink, __NR_add_key,
    __NR_request_key, __NR_keyctl,
    // Namespaces and mounts.
    __NR_unshare, __NR_setns, __NR_mount, __NR_umount2, __NR_pivot_root, __NR_chroot,
    __NR_open_tree, __NR_move_mount, __NR_fsopen, __NR_fsconfig, __NR_fsmount, __NR_fspick,
    __NR_mount_setattr, __NR_open_by_handle_at, __NR_name_to_handle_at, __NR_fanotify_init,
    // The kernel.
    __NR_bpf, __NR_perf_event_open, __NR_userfaultfd, __NR_init_module, __NR_finit_module,
    __NR_delete_module, __NR_kexec_load, __NR_reboot, __NR_swapon, __NR_swapoff, __NR_acct,
    __NR_quotactl, __NR_syslog, __NR_settimeofday, __NR_clock_settime, __NR_clock_adjtime,
    __NR_adjtimex, __NR_sethostname, __NR_setdomainname, __NR_vhangup};

// Refused where they could reach processes outside.
constexpr int kSignals[] = {__NR_rt_sigqueueinfo, __NR_rt_tgsigqueueinfo, __NR_pidfd_send_signal,
                            __NR_tkill};
constexpr int kSignalsByPid[] = {__NR_kill, __NR_tgkill};

constexpr int kScannerNeeds[] = {__NR_read,
                                 __NR_readv,
                                 __NR_pread64,
                                 __NR_write,
                                 __NR_writev,
                                 __NR_close,
                                 __NR_lseek,
                                 __NR_fstat,
                                 __NR_newfstatat,
                                 __NR_mmap,
                                 __NR_munmap,
                                 __NR_mremap,
                                 __NR_mprotect,
                                 __NR_madvise,
                                 __NR_brk,
                                 __NR_futex,
                                 __NR_exit,
                                 __NR_exit_group,
                                 __NR_rt_sigreturn,
                                 __NR_rt_sigaction,
                                 __NR_rt_sigprocmask,
                                 __NR_sigaltstack,
                                 __NR_clock_gettime,
                                 __NR_gettimeofday,
                                 __NR_nanosleep,
                                 __NR_clock_nanosleep,
                                 __NR_getrandom,
                                 __NR_getpid,
                                 __NR_gettid,
                                 __NR_sched_yield,
                                 __NR_restart_syscall,
                                 __NR_rseq,
                                 __NR_set_robust_list,
                                 __NR_prlimit64,
                                 __NR_sched_getaffinity};

class Filter {
 public:
  Filter() {
    Load(offsetof(seccomp_data, arch));
    Add(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, kArch, 1, 0));
    Return(SECCOMP_RET_KILL_PROCESS);
    LoadNumber();
#if defined(__x86_64__)
    Add(BPF_JUMP(BPF_JMP | BPF_JGE | BPF_K, kX32Bit, 0, 1));
    Return(kRefuse);
#endif
  }
  void On(int number, uint32_t result) {
    Add(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, static_cast<uint32_t>(number), 0, 1));
    Return(result);
  }
  // Refused if the lower half of argument `index` has one of `bits`.
  void RefuseBits(int number, int index, uint32_t bits) {
    Add(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, static_cast<uint32_t>(number), 0, 4));
    Load(offsetof(seccomp_data, args) + sizeof(uint64_t) * static_cast<size_t>(index));
    Add(BPF_JUMP(BPF_JMP | BPF_JSET | BPF_K, bits, 0, 1));
    Return(kRefuse);
    LoadNumber();
  }
  // Refused if the lower half of argument `index` is not `value`.
  void RefuseOthers(int number, int index, uint32_t value) {
    Add(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, static_cast<uint32_t>(number), 0, 4));
    Load(offsetof(seccomp_data, args) + sizeof(uint64_t) * static_cast<size_t>(index));
    Add(BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, value, 1, 0));
    Return(kRefuse);
    LoadNumber();
  }
  int Apply(uint32_t otherwise) {
    Return(otherwise);
    const sock_fprog program = {.len = static_cast<unsigned short>(code_.size()),
                                .filter = code_.data()};
    return prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program) == 0 ? 0 : errno;
  }

 private:
  void Add(sock_filter instruction) { code_.push_back(instruction); }
  void Load(size_t offset) {
    Add(BPF_STMT(BPF_LD | BPF_W | BPF_ABS, static_cast<uint32_t>(offset)));
  }
  void LoadNumber() { Load(offsetof(seccomp_data, nr)); }
  void Return(uint32_t result) { Add(BPF_STMT(BPF_RET | BPF_K, result)); }

  std::vector<sock_filter> code_;
};

}  // namespace

int ApplySeccomp(SeccompProfile profile) {
  Filter filter;
  if (profile == SeccompProfile::kScanner) {
    for (const int number : kScannerNeeds) filter.On(number, SECCOMP_RET_ALLOW);
    filter.RefuseOthers(__NR_tgkill, 0, static_cast<uint32_t>(getpid()));  // abort()
    filter.On(__NR_tgkill, SECCOMP_RET_ALLOW);
    return filter.Apply(kRefuse);
  }
  for (const int number : kNeverForPlugins) filter.On(number, kRefuse);
  filter.RefuseBits(__NR_clone, 0, kNamespaces);
  filter.On(__NR_clone3, SECCOMP_RET_ERRNO | ENOSYS);  // its flags cannot be seen; libc uses clone
  filter.RefuseOthers(__NR_prlimit64, 0, 0);
  filter.RefuseOthers(__NR_sched_setaffinity, 0, 0);
  if (profile == SeccompProfile::kPluginWithoutPidNamespace) {
    const auto self = static_cast<uint32_t>(getpid());
    for (const int number : kSignals) filter.On(number, kRefuse);
    for (const int number : kSignalsByPid) filter.RefuseOthers(number, 0, self);
  }
  return filter.Apply(SECCOMP_RET_ALLOW);
}

}  // namespace rips::inspect
