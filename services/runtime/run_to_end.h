// Runs one program to its end: no shell, a session of its own, no descriptor, signal mask or
// environment of ours, and a deadline. By posix_spawn, which copies no page tables and runs no
// pthread_atfork handlers.
//
// A run is over when its main process has ended, has run out of time, or has printed too much. Its
// process group is killed then, and the main process is reaped; a process that left the group by
// setsid() escapes. The calling process must not wait for children of unknown id.
#ifndef RIPS_SERVICES_RUNTIME_RUN_TO_END_H_
#define RIPS_SERVICES_RUNTIME_RUN_TO_END_H_

#include <cstddef>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"

namespace rips {

struct ProgramCall {
  // The file, absolute, and its arguments; at least one word.
  std::vector<std::string> words;
  // `NAME=VALUE`; the program has no other variable.
  std::vector<std::string> environment;
  // Its standard input, then end of file.
  std::string input;
  absl::Duration timeout;
  // Of standard output, and of standard error.
  size_t output_bytes_max = 64 << 10;
  // The run is given up when it is readable; negative: never.
  int cancel_fd = -1;
};

struct ProgramEnd {
  // 128 and the signal's number if one ended it.
  int exit_code = 0;
  std::string out;
  std::string err;
};

// Blocks, but no longer than `timeout`; any thread. Unavailable: it cannot be started;
// DeadlineExceeded: it did not end in time; ResourceExhausted: it printed more than
// `output_bytes_max`; Cancelled: `cancel_fd`.
absl::StatusOr<ProgramEnd> RunToEnd(const ProgramCall& call);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_RUN_TO_END_H_
