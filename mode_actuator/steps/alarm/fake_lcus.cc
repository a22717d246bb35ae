#include "mode_actuator/steps/alarm/fake_lcus.h"

#include <fcntl.h>
#include <poll.h>
#include <pty.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <cerrno>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "mode_actuator/steps/alarm/frames.h"

namespace rips::actuator {
namespace {

constexpr size_t kOrderBytes = 4;

}  // namespace

FakeLcus::FakeLcus(Answer answer) : answer_(answer) {
  int master = -1;
  int slave = -1;
  char name[64];
  EXPECT_EQ(openpty(&master, &slave, name, nullptr, nullptr), 0);
  master_ = UniqueFd(master);
  slave_ = UniqueFd(slave);
  path_ = name;
  int ends[2];
  EXPECT_EQ(pipe2(ends, O_CLOEXEC), 0);
  stop_read_ = UniqueFd(ends[0]);
  stop_write_ = UniqueFd(ends[1]);
  termios raw = mode();
  cfmakeraw(&raw);
  EXPECT_EQ(tcsetattr(slave, TCSANOW, &raw), 0);
  thread_ = std::thread([this] { Loop(); });
}

void FakeLcus::Unplug() {
  if (!thread_.joinable()) return;
  stop_write_.Reset();
  thread_.join();
  slave_.Reset();
  master_.Reset();
}

void FakeLcus::EndExclusiveUse() { EXPECT_EQ(ioctl(slave_.get(), TIOCNXCL), 0); }

void FakeLcus::set_answer(Answer answer) {
  MutexLock lock(&mu_);
  answer_ = answer;
}

void FakeLcus::Force(int relay, bool on) {
  MutexLock lock(&mu_);
  relays_[relay - 1] = on;
}

bool FakeLcus::is_on(int relay) {
  MutexLock lock(&mu_);
  return relays_[relay - 1];
}

termios FakeLcus::mode() const {
  termios mode = {};
  EXPECT_EQ(tcgetattr(slave_.get(), &mode), 0);
  return mode;
}

void FakeLcus::Loop() {
  std::string input;
  while (true) {
    pollfd fds[2] = {{master_.get(), POLLIN, 0}, {stop_read_.get(), POLLIN, 0}};
    if (poll(fds, 2, -1) < 0 && errno != EINTR) return;
    if (fds[1].revents != 0) return;
    char bytes[64];
    const ssize_t got = read(master_.get(), bytes, sizeof(bytes));
    if (got <= 0) continue;
    input.append(bytes, static_cast<size_t>(got));
    while (!input.empty()) {
      const bool query = static_cast<uint8_t>(input[0]) == kLcusQuery;
      if (!query && input.size() < kOrderBytes) break;
      if (query) {
        const std::string text = Say();
        EXPECT_EQ(write(master_.get(), text.data(), text.size()),
                  static_cast<ssize_t>(text.size()));
      } else {
        Switch(input);
      }
      input.erase(0, query ? 1 : kOrderBytes);
    }
  }
}

void FakeLcus::Switch(const std::string& frame) {
  MutexLock lock(&mu_);
  const bool on = frame[2] == 1;
  EXPECT_EQ(Frame(frame.begin(), frame.begin() + kOrderBytes), LcusFrame(frame[1], on));
  if (frame[1] == 1 || frame[1] == 2) relays_[frame[1] - 1] = on;
}

std::string FakeLcus::Say() {
  MutexLock lock(&mu_);
  const auto word = [](bool on) { return on ? " ON " : "OFF"; };
  switch (answer_) {
    case Answer::kText:
      return absl::StrCat("CH1:", word(relays_[0]), "\r\nCH2:", word(relays_[1]), "\r\n");
    case Answer::kBytes:
      return {static_cast<char>(relays_[0]), static_cast<char>(relays_[1])};
    case Answer::kNothing:
      return "";
    case Answer::kGarbage:
      return "\x1b[2J\x07 what?";
    case Answer::kFlood:
      return std::string(1000, 'C');
    case Answer::kCut:
      return "CH1:";
  }
  return "";
}

}  // namespace rips::actuator
