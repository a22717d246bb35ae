// Port: running a program of the allow-list.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PORT_PROGRAM_RUNNER_H_
#define RIPS_MODE_ACTUATOR_STEPS_PORT_PROGRAM_RUNNER_H_

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"

namespace rips::actuator {

inline constexpr size_t kOutputBytesMax = 64 << 10;  // kept, from the end
inline constexpr size_t kProgramNameBytesMax = 256;
inline constexpr size_t kArgsMax = 64;
inline constexpr size_t kArgBytesMax = 4096;
inline constexpr int kRunsMax = 16;  // programs at the same time
// Between SIGTERM and SIGKILL.
inline constexpr absl::Duration kTermGrace = absl::Milliseconds(300);

struct ProgramRequest {
  std::string name;  // in the allow-list
  std::vector<std::string> args;
  absl::Duration timeout;  // cut to the program's own
  bool drill = false;      // passed as RIPS_DRILL=1
  // Of a level step, passed as RIPS_LEVEL_FROM and RIPS_LEVEL_TO; empty = not known.
  std::string level_from;
  std::string level_to;
};

struct ProgramResult {
  // OK = exited with 0. DeadlineExceeded = killed for time, Cancelled = by Cancel(), Aborted = any
  // other end, Unknown = it was begun, and its end is not known. If it was not begun, as
  // Start's.
  absl::Status status;
  bool begun = true;        // false: it did not run at all, and `status` says why
  int exit_code = 0;        // 128 + signal if killed
  std::string output_tail;  // stdout and stderr together, the last kOutputBytesMax bytes
  std::string note;         // a warning although it may have succeeded; mostly empty
  uint64_t output_bytes = 0;
  uint32_t took_ms = 0;
};

// The message of its status and its note.
inline std::string ProgramDetail(const ProgramResult& result) {
  std::string detail(result.status.message());
  if (!detail.empty() && !result.note.empty()) detail += "; ";
  return detail + result.note;
}

// Any thread.
class ProgramRunner {
 public:
  using Done = std::function<void(ProgramResult)>;
  virtual ~ProgramRunner() = default;

  // Asks for it and returns. `done` is called once, on the runner's thread, and must not block; it
  // is not called if the status is not OK: PermissionDenied (not in the allow-list, or the file is
  // not safe to run), NotFound (no such file), InvalidArgument (arguments), ResourceExhausted
  // (concurrency, rate; later it may work), Unavailable (the system could not start it). A runner
  // that learns of such a refusal only later reports it by `done`.
  virtual absl::StatusOr<uint64_t> Start(const ProgramRequest& request, Done done) = 0;
  // SIGTERM to its process group, SIGKILL after kTermGrace; `done` follows. No-op when over.
  virtual void Cancel(uint64_t run) = 0;
  // OK if the program could be started now: in the allow-list, its file there and safe, whoever
  // starts it there. Else as Start says. May take seconds.
  virtual absl::Status Examine(absl::string_view name) = 0;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PORT_PROGRAM_RUNNER_H_
