// Port: running a program of the allow-list.
#ifndef RIPS_MODE_ACTUATOR_PROGRAM_RUNNER_H_
#define RIPS_MODE_ACTUATOR_PROGRAM_RUNNER_H_

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"

namespace rips::actuator {

inline constexpr size_t kOutputBytesMax = 64 << 10;  // kept, from the end
inline constexpr size_t kArgsMax = 64;
inline constexpr size_t kArgBytesMax = 4096;
inline constexpr int kRunsMax = 16;  // programs at the same time
// Between SIGTERM and SIGKILL.
inline constexpr absl::Duration kTermGrace = absl::Milliseconds(300);

struct ProgramRequest {
  std::string name;  // in the allow-list
  std::vector<std::string> args;
  absl::Duration timeout;  // cut to the program's own
};

struct ProgramResult {
  // OK = exited with 0. DeadlineExceeded = killed for time, Cancelled = by Cancel(), Aborted = any
  // other end.
  absl::Status status;
  int exit_code = 0;        // 128 + signal if killed
  std::string output_tail;  // stdout and stderr together, the last kOutputBytesMax bytes
  uint64_t output_bytes = 0;
  uint32_t took_ms = 0;
};

// Any thread.
class ProgramRunner {
 public:
  using Done = std::function<void(ProgramResult)>;
  virtual ~ProgramRunner() = default;

  // Starts it and returns. `done` is called once, on the runner's thread, and must not block; it is
  // not called if the status is not OK: PermissionDenied (not in the allow-list, or the file is not
  // safe to run), NotFound (no such file), InvalidArgument (arguments), ResourceExhausted
  // (concurrency; later it may work), Unavailable (the system could not start it).
  virtual absl::StatusOr<uint64_t> Start(const ProgramRequest& request, Done done) = 0;
  // SIGTERM to its process group, SIGKILL after kTermGrace; `done` follows. No-op when over.
  virtual void Cancel(uint64_t run) = 0;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_PROGRAM_RUNNER_H_
