#include "policy_server/ripsctl/top/terminal.h"

#include <poll.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cerrno>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/wake_fd.h"

namespace rips::ripsctl {
namespace {

// Alternate screen, no cursor, no wrapping of long lines; and all of it back.
constexpr absl::string_view kEnter = "\x1b[?1049h\x1b[?25l\x1b[?7l";
constexpr absl::string_view kLeave = "\x1b[0m\x1b[?7h\x1b[?25h\x1b[?1049l";
constexpr int kEndSignals[] = {SIGINT, SIGTERM, SIGHUP, SIGQUIT};
constexpr char kCtrlC = '\x03';

// Written by the handlers, which may run on any thread: they do nothing else.
std::atomic<int> end_signal = 0;
static_assert(std::atomic<int>::is_always_lock_free);
const WakeFd& SignalWake() {
  static const WakeFd* const wake = new WakeFd();
  return *wake;
}
std::atomic<int> signal_wake_fd = -1;

void OnSignal(int signal) {
  const int saved = errno;
  if (signal != SIGWINCH) end_signal = signal;
  const uint64_t one = 1;
  [[maybe_unused]] const ssize_t written = write(signal_wake_fd, &one, sizeof one);
  errno = saved;
}

// As typed, without echo; Ctrl-C is a key, and Ctrl-Z cannot leave the alternate screen behind.
termios Raw(termios settings) {
  settings.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO | ISIG | IEXTEN);
  settings.c_iflag &= ~static_cast<tcflag_t>(IXON);
  settings.c_cc[VMIN] = 1;
  settings.c_cc[VTIME] = 0;
  return settings;
}

}  // namespace

absl::StatusOr<std::unique_ptr<Terminal>> Terminal::Open(TerminalFds fds) {
  termios before{};
  if (fds.in < 0 || fds.out < 0 || tcgetattr(fds.in, &before) != 0 || isatty(fds.out) != 1) {
    return absl::FailedPreconditionError("standard input and output must be a terminal");
  }
  auto terminal = std::unique_ptr<Terminal>(new Terminal(fds, before));
  const termios raw = Raw(before);
  if (tcsetattr(fds.in, TCSANOW, &raw) != 0) {
    return absl::ErrnoToStatus(errno, "cannot set the terminal's mode");
  }
  RIPS_RETURN_IF_ERROR(terminal->Write(kEnter));
  return terminal;
}

Terminal::Terminal(TerminalFds fds, const termios& before) : fds_(fds), before_(before) {
  signal_wake_fd = SignalWake().get();
  SignalWake().Drain();
  end_signal = 0;
  struct sigaction action {};
  action.sa_handler = OnSignal;  // without SA_RESTART: a blocked write ends
  sigfillset(&action.sa_mask);
  const auto handle = [&](int signal) {
    struct sigaction old {};
    sigaction(signal, &action, &old);
    handlers_before_.emplace_back(signal, old);
  };
  for (const int signal : kEndSignals) handle(signal);
  handle(SIGWINCH);
}

Terminal::~Terminal() {
  end_signal = 0;  // which would make Write give up
  Write(kLeave).IgnoreError();
  tcsetattr(fds_.in, TCSANOW, &before_);
  for (const auto& [signal, old] : handlers_before_) sigaction(signal, &old, nullptr);
}

TerminalSize Terminal::size() const {
  winsize size{};
  if (ioctl(fds_.out, TIOCGWINSZ, &size) != 0 || size.ws_col == 0 || size.ws_row == 0) return {};
  return {.columns = size.ws_col, .rows = size.ws_row};
}

absl::Status Terminal::Write(absl::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = write(fds_.out, bytes.data(), bytes.size());
    if (written >= 0) {
      bytes.remove_prefix(static_cast<size_t>(written));
    } else if (errno == EAGAIN) {
      pollfd ready = {.fd = fds_.out, .events = POLLOUT, .revents = 0};
      poll(&ready, 1, -1);
    } else if (errno != EINTR) {
      return absl::InternalError(
          absl::StrCat("cannot write to the terminal: ", absl::ErrnoToStatus(errno, "").message()));
    }
    // A terminal that takes nothing must not keep the process from its end.
    if (end_signal != 0) return absl::OkStatus();
  }
  return absl::OkStatus();
}

Terminal::Wake Terminal::Wait(int fd, absl::Duration timeout) {
  pollfd fds[] = {{.fd = fds_.in, .events = POLLIN, .revents = 0},
                  {.fd = SignalWake().get(), .events = POLLIN, .revents = 0},
                  {.fd = fd, .events = POLLIN, .revents = 0}};
  const int64_t milliseconds =
      absl::ToInt64Milliseconds(absl::Ceil(timeout, absl::Milliseconds(1)));
  const int ready = poll(fds, std::size(fds), static_cast<int>(std::max<int64_t>(0, milliseconds)));
  if (end_signal != 0) return Wake::kEnd;
  if (ready == 0) return Wake::kTimeout;
  if (ready < 0) return errno == EINTR ? Wake::kOther : Wake::kEnd;
  if (fds[1].revents != 0) SignalWake().Drain();
  if (fds[0].revents != 0) {
    char keys[64];
    const ssize_t count = read(fds_.in, keys, sizeof keys);
    if (count == 0 || (count < 0 && errno != EINTR && errno != EAGAIN)) return Wake::kEnd;
    const auto ends = [](char key) { return key == 'q' || key == 'Q' || key == kCtrlC; };
    if (count > 0 && std::any_of(keys, keys + count, ends)) return Wake::kEnd;
    if (fds[1].revents == 0 && fds[2].revents == 0) return Wake::kTimeout;  // no key of ours
  }
  return Wake::kOther;
}

}  // namespace rips::ripsctl
