#include "mode_actuator/steps/alarm/tty_channel.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "mode_actuator/steps/port/alarms.h"
#include "services/base/status_macros.h"

namespace rips::actuator {
namespace {

absl::Status SystemError(absl::string_view what, int error) {
  return absl::UnavailableError(absl::StrCat(what, ": ", std::strerror(error)));
}

// Waits for `events`; 0 = none came in time. Unavailable if the line is gone.
absl::StatusOr<short> PollUntil(int fd, short events, absl::Time end) {
  while (true) {
    pollfd entry = {.fd = fd, .events = events, .revents = 0};
    const int64_t left_ms = std::max<int64_t>(
        0, absl::ToInt64Milliseconds(absl::Ceil(end - absl::Now(), absl::Milliseconds(1))));
    const int ready = poll(&entry, 1, static_cast<int>(left_ms));
    if (ready < 0 && errno == EINTR) continue;
    if (ready < 0) return SystemError("polling the serial line", errno);
    if ((entry.revents & (POLLHUP | POLLERR | POLLNVAL)) != 0) {
      return absl::UnavailableError("the serial line is gone");
    }
    return entry.revents;
  }
}

absl::Status SetUp(int fd) {
  termios mode;
  if (tcgetattr(fd, &mode) != 0) return SystemError("reading the mode of the serial line", errno);
  cfmakeraw(&mode);
  cfsetspeed(&mode, B9600);
  mode.c_cflag &= ~static_cast<tcflag_t>(CSTOPB | PARENB | CRTSCTS | HUPCL);
  mode.c_cflag |= CS8 | CREAD | CLOCAL;
  mode.c_iflag &= ~static_cast<tcflag_t>(IXON | IXOFF | IXANY);
  mode.c_cc[VMIN] = 0;
  mode.c_cc[VTIME] = 0;
  if (tcsetattr(fd, TCSANOW, &mode) != 0) return SystemError("setting up the serial line", errno);
  if (ioctl(fd, TIOCEXCL) != 0) return SystemError("reserving the serial line", errno);
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<std::unique_ptr<TtyChannel>> TtyChannel::Open(const std::string& path,
                                                             IoGate* gate) {
  const IoGate::Exchange exchange(gate);
  RIPS_RETURN_IF_ERROR(exchange.status());
  UniqueFd fd(open(path.c_str(), O_RDWR | O_NOCTTY | O_NONBLOCK | O_CLOEXEC));
  if (fd.get() < 0) {
    if (errno == ENOENT || errno == ENXIO || errno == ENODEV) {
      return absl::NotFoundError(absl::StrCat("no `", path, "`; is the device plugged in?"));
    }
    return SystemError(absl::StrCat("cannot open `", path, "`"), errno);
  }
  if (isatty(fd.get()) != 1) {
    return absl::NotFoundError(absl::StrCat("`", path, "` is no serial line"));
  }
  RIPS_RETURN_IF_ERROR(SetUp(fd.get()));
  return std::unique_ptr<TtyChannel>(new TtyChannel(std::move(fd), gate));
}

absl::Status TtyChannel::WriteAll(const Frame& frame) {
  const absl::Time end = absl::Now() + kAlarmIoBudget;
  for (size_t sent = 0; sent < frame.size();) {
    RIPS_ASSIGN_OR_RETURN(const short ready, PollUntil(fd_.get(), POLLOUT, end));
    if (ready == 0) {
      return absl::DeadlineExceededError(absl::StrCat("the serial line took ", sent, " of ",
                                                      frame.size(), " bytes in ",
                                                      absl::FormatDuration(kAlarmIoBudget)));
    }
    const ssize_t written = write(fd_.get(), frame.data() + sent, frame.size() - sent);
    if (written < 0 && errno != EAGAIN && errno != EINTR) {
      return SystemError("writing to the serial line", errno);
    }
    sent += written > 0 ? static_cast<size_t>(written) : 0;
  }
  return absl::OkStatus();
}

absl::Status TtyChannel::Write(const Frame& frame) {
  const IoGate::Exchange exchange(gate_);
  RIPS_RETURN_IF_ERROR(exchange.status());
  return WriteAll(frame);
}

absl::StatusOr<std::string> TtyChannel::Ask(const Frame& question, absl::Duration first_wait) {
  const IoGate::Exchange exchange(gate_);
  RIPS_RETURN_IF_ERROR(exchange.status());
  if (tcflush(fd_.get(), TCIFLUSH) != 0) return SystemError("the serial line", errno);
  RIPS_RETURN_IF_ERROR(WriteAll(question));
  std::string answer;
  const absl::Time last = absl::Now() + kAnswerTime;
  absl::Time end = absl::Now() + first_wait;
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const short ready, PollUntil(fd_.get(), POLLIN, end));
    if (ready == 0) return answer;
    char bytes[128];
    const ssize_t got = read(fd_.get(), bytes, sizeof(bytes));
    if (got == 0) return absl::UnavailableError("the serial line is gone");
    if (got < 0 && errno != EAGAIN && errno != EINTR) {
      return SystemError("reading the serial line", errno);
    }
    if (got < 0) continue;
    answer.append(bytes, static_cast<size_t>(got));
    if (answer.size() > kLcusAnswerBytesMax) {
      return absl::ResourceExhaustedError(
          absl::StrCat("the answer exceeds limit ", kLcusAnswerBytesMax, " bytes"));
    }
    end = std::min(absl::Now() + kQuiet, last);
  }
}

absl::Status TtyChannel::Probe() {
  const IoGate::Exchange exchange(gate_);
  RIPS_RETURN_IF_ERROR(exchange.status());
  return PollUntil(fd_.get(), POLLIN, absl::InfinitePast()).status();
}

}  // namespace rips::actuator
