// What tests of the bus share: processes of their own, and a network of their own. Test code only.
#ifndef RIPS_TESTS_INTEGRATION_BUS_WORLD_H_
#define RIPS_TESTS_INTEGRATION_BUS_WORLD_H_

#include <fcntl.h>
#include <net/if.h>
#include <sched.h>
#include <signal.h>
#include <spawn.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "services/base/ids.h"
#include "tests/support/ros2/test_world.h"

namespace rips::bus {

// A network namespace of this process alone, whose loopback interface is up; it goes with the
// process. False where that is not granted. Before any thread is started.
inline bool EnterOwnNetwork() {
  if (unshare(CLONE_NEWNET) != 0 && unshare(CLONE_NEWUSER | CLONE_NEWNET) != 0) return false;
  const int fd = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return false;
  ifreq request = {};
  std::strcpy(request.ifr_name, "lo");
  request.ifr_flags = IFF_UP | IFF_RUNNING;
  const bool up = ioctl(fd, SIOCSIFFLAGS, &request) == 0;
  close(fd);
  return up;
}

// A child process; killed when this goes, if it still runs.
class Child {
 public:
  Child(const std::string& program, const std::vector<std::string>& arguments)
      : output_(std::filesystem::temp_directory_path() / absl::StrCat("rips-bus-", NewId())) {
    std::vector<std::string> words = {absl::StrCat(RIPS_BIN_DIR, "/", program)};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_addopen(&actions, 1, output_.c_str(), O_CREAT | O_WRONLY | O_APPEND,
                                     0600);
    posix_spawn_file_actions_adddup2(&actions, 1, 2);
    EXPECT_EQ(posix_spawn(&pid_, argv[0], &actions, nullptr, argv.data(), environ), 0) << program;
    posix_spawn_file_actions_destroy(&actions);
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;
  ~Child() {
    if (pid_ > 0) End(SIGKILL);
    std::filesystem::remove(output_);
  }

  pid_t pid() const { return pid_; }
  std::vector<std::string> Lines() const {
    std::vector<std::string> lines;
    std::ifstream file(output_);
    for (std::string line; std::getline(file, line);) lines.push_back(line);
    return lines;
  }
  // The first line that begins so; empty if none does.
  std::string Line(const std::string& beginning) const {
    for (const std::string& line : Lines()) {
      if (absl::StartsWith(line, beginning)) return line;
    }
    return {};
  }
  bool WaitFor(const std::string& beginning) const {
    return dds::Eventually([&] { return !Line(beginning).empty(); });
  }
  // By `sig`, or by itself if that is 0. False if it does not end.
  bool End(int sig) {
    if (sig != 0) kill(pid_, sig);
    const bool ended = dds::Eventually([&] { return waitpid(pid_, nullptr, WNOHANG) == pid_; });
    if (ended) pid_ = 0;
    return ended;
  }

 private:
  const std::filesystem::path output_;
  pid_t pid_ = 0;
};

}  // namespace rips::bus

#endif  // RIPS_TESTS_INTEGRATION_BUS_WORLD_H_
