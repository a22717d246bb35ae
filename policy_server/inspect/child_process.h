// One process of a plugin: started without a shell and with nothing of ours, ended with all that it
// started.
#ifndef RIPS_POLICY_SERVER_INSPECT_CHILD_PROCESS_H_
#define RIPS_POLICY_SERVER_INSPECT_CHILD_PROCESS_H_

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/base/clock.h"

namespace rips::inspect {

// Soft and hard limits (setrlimit) of the process; files it writes and core dumps have 0 bytes.
struct ChildLimits {
  // 0: none, for programs built with AddressSanitizer.
  uint64_t address_space_bytes = uint64_t{1} << 30;
  uint64_t open_files = 64;
};

// Bytes of a line that Errors shows.
inline constexpr size_t kErrorLineBytesMax = 200;

// Not thread-safe.
//
// The process has: descriptors 0, 1 and 2 to us, no others; PATH and LANG and no other variable;
// the directory `/`; default signal handling; a session and process group of its own; no new
// privileges by setuid programs. It is killed when this is destroyed, and when the thread that
// started it ends. What it starts is killed with it, but for what leaves the group by setsid():
// nobody listens to that any more.
class ChildProcess {
 public:
  // `path` is absolute. Returns when the program runs. InvalidArgument: it cannot be executed, and
  // why; Unavailable: no process or descriptor to be had.
  static absl::StatusOr<std::unique_ptr<ChildProcess>> Start(const std::string& path,
                                                             const ChildLimits& limits);
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

  // What it wrote to descriptor 2 as far as Wait has seen it, and all once Exited tells an end; it
  // is read and dropped but for this. Empty if it wrote nothing. The first line and, if there are
  // more, ` ... ` and the last, each cut to kErrorLineBytesMax and of printable ASCII only, for it
  // may quote hostile messages; `(blank)` if that leaves nothing.
  std::string Errors() const;

  pid_t pid() const { return pid_; }

 private:
  ChildProcess(pid_t pid, int input, int output, int errors);
  void Reap();
  void ReadErrors();

  const pid_t pid_;
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

#endif  // RIPS_POLICY_SERVER_INSPECT_CHILD_PROCESS_H_
