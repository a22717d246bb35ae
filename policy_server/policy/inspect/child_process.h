// One process that looks at hostile payloads: a plugin, contained by rips-inspect, or a scanner,
// rips-scan (helper/), ended with all that it started.
//
// What the program cannot do, and by what:
//   open files but the bundle's and the system's, to read; write any   Landlock, no other user
//   open the memory of other processes, trace them Landlock, seccomp, PID namespace signal
//   processes outside PID namespace, other user make sockets, reach the network or a Unix socket
//   seccomp gain rights by setuid programs, use capabilities no_new_privs, empty sets outlive us by
//   setsid() or a second fork cgroup; PID namespace, or sweep use up memory, processes,
//   descriptors, disk limits
// What the kernel at hand cannot do of it is told (missing()).
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_CHILD_PROCESS_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_CHILD_PROCESS_H_

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/inspect/jail_spec.h"
#include "services/base/clock.h"
#include "services/runtime/run_cgroups.h"

namespace rips::inspect {

// Soft and hard limits (setrlimit) of the process; files it writes and core dumps have 0 bytes.
struct ChildLimits {
  // 0: none, for programs built with AddressSanitizer.
  uint64_t address_space_bytes = uint64_t{1} << 30;
  uint64_t open_files = 64;
  // Processes and threads of one plugin.
  uint64_t tasks = 128;
  // Of one plugin together, if the memory controller is switched on for our cgroup.
  uint64_t memory_bytes = uint64_t{2} << 30;
};

// How processes are contained.
struct Containment {
  // Where rips-inspect and rips-scan are; empty: beside our own binary.
  std::string helpers;
  // Whom plugins and scanners run as. Only root may give any; none: ourselves.
  std::optional<JailIds> ids;
  // Absolute paths that plugins may read and execute, besides the system's and their bundle's.
  std::vector<std::string> readable;
  // Not owned, outlives the processes; null: without.
  RunCgroups* cgroups = nullptr;
};

// Starts rips-inspect as for a plugin, and gives what it could not enforce on this machine, a line
// each. Errors as ChildProcess::StartPlugin.
absl::StatusOr<std::vector<std::string>> ProbeContainment(const Containment& containment);

// Bytes of a line that Errors shows.
inline constexpr size_t kErrorLineBytesMax = 200;

// Not thread-safe.
//
// A plugin has: descriptors 0, 1 and 2 to us, no others; PATH and LANG and no other variable; the
// directory `/`; default signal handling. A scanner has the two given besides. The process is
// killed when this is destroyed, and when the thread that started it ends, and what it started with
// it.
class ChildProcess {
 public:
  // Runs `program`, absolute, which may read `root`, the directory of its bundle. Returns when it
  // runs. InvalidArgument: it, or its helper, cannot be executed or contained, and why;
  // Unavailable: no process, descriptor or cgroup to be had.
  static absl::StatusOr<std::unique_ptr<ChildProcess>> StartPlugin(const std::string& program,
                                                                   const std::string& root,
                                                                   const ChildLimits& limits,
                                                                   const Containment& containment);
  // Runs a scanner (helper/scan_loop.h) with copies of these descriptors. Returns when it has
  // loaded its rules. Errors as above; InvalidArgument also if it cannot load them.
  static absl::StatusOr<std::unique_ptr<ChildProcess>> StartScanner(int rules_fd, int payload_fd,
                                                                    const ChildLimits& limits,
                                                                    const Containment& containment);
  // Kills the group and reaps the process.
  ~ChildProcess();
  ChildProcess(const ChildProcess&) = delete;
  ChildProcess& operator=(const ChildProcess&) = delete;

  enum class Io {
    kDone,     // all written, or something read
    kBlocked,  // nothing more for now; Wait
    kClosed,   // the other side is closed; for good
  };
  // Writes from the front of `rest` and shortens it. Never blocks, raises no SIGPIPE.
  Io Write(absl::string_view& rest);
  // The process reads end of file after what was written.
  void CloseInput();
  // Appends to `text` until it has `bytes_max` bytes (kDone). Never blocks.
  Io Read(std::string& text, size_t bytes_max);

  // Waits until there is output (also on descriptor 2), an end, or, if `to_write`, room for input.
  // False once `deadline_ns` (boottime of `clock`) has passed. May return early.
  bool Wait(bool to_write, int64_t deadline_ns, const Clock& clock);

  struct Exit {
    // The exit status, or -1 after a signal.
    int status = 0;
  };
  // How it ended; nullopt while it runs. What it started is killed then too.
  std::optional<Exit> Exited();

  // What it has written to descriptor 2 so far, and all once Exited tells an end; it is read and
  // dropped but for this. Empty if it wrote nothing. The first line and, if there are more, ` ... `
  // and the last, each cut to kErrorLineBytesMax and of printable ASCII only, for it may quote
  // hostile messages; `(blank)` if that leaves nothing.
  std::string Errors();

  // What this machine cannot enforce on it.
  const std::vector<std::string>& missing() const { return missing_; }

  pid_t pid() const { return pid_; }

 private:
  friend absl::StatusOr<std::vector<std::string>> ProbeContainment(const Containment& containment);
  struct Command;

  ChildProcess(pid_t pid, int input, int output, int errors, std::unique_ptr<RunCgroup> cgroup);
  static absl::StatusOr<std::unique_ptr<ChildProcess>> Start(const Command& command,
                                                             const ChildLimits& limits,
                                                             const Containment& containment);
  absl::Status ReadReport(int fd, const std::string& helper);
  void KillAll();
  void Reap();
  void ReadErrors();

  const pid_t pid_;
  std::unique_ptr<RunCgroup> cgroup_;
  // Nothing but rips-inspect itself ends what the program started.
  bool sweeps_ = false;
  std::vector<std::string> missing_;
  int pidfd_;
  int input_;
  int output_;
  int errors_;
  // The first and the last bytes read from `errors_`.
  std::string errors_begin_;
  std::string errors_end_;
  std::optional<Exit> exit_;
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_CHILD_PROCESS_H_
