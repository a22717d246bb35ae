// The operator's terminal as one screen of lines. Plain ANSI, no terminal library.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_TOP_TERMINAL_H_
#define RIPS_POLICY_SERVER_RIPSCTL_TOP_TERMINAL_H_

#include <signal.h>
#include <termios.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/env.h"
#include "policy_server/ripsctl/top/fleet_view.h"

namespace rips::ripsctl {

// While it lives, the terminal shows its alternate screen, without cursor, and gives each key at
// once. Then it is as it was: also after SIGINT, SIGTERM, SIGHUP and SIGQUIT, which end a wait.
// SIGKILL, SIGSTOP and a crash leave it changed; `reset` restores it.
//
// At most one at a time in a process, as signals are the process's. One thread.
class Terminal {
 public:
  enum class Wake {
    kTimeout,
    kOther,  // the given descriptor is readable, or the size may have changed
    kEnd,    // q, Ctrl-C, one of the signals, or the terminal is gone
  };

  // FailedPrecondition if one of `fds` is no terminal. They are not owned.
  static absl::StatusOr<std::unique_ptr<Terminal>> Open(TerminalFds fds);
  ~Terminal();
  Terminal(const Terminal&) = delete;
  Terminal& operator=(const Terminal&) = delete;

  // 80x24 if the terminal does not say.
  TerminalSize size() const;
  // Internal if the terminal does not take it.
  absl::Status Write(absl::string_view bytes);
  // Waits for a key, a signal, or `fd` to be readable; at most `timeout`, at least 0.
  Wake Wait(int fd, absl::Duration timeout);

 private:
  Terminal(TerminalFds fds, const termios& before);

  const TerminalFds fds_;
  const termios before_;
  std::vector<std::pair<int, struct sigaction>> handlers_before_;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_TOP_TERMINAL_H_
