// Runs a program as a test does, to its end.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RUN_PROGRAM_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RUN_PROGRAM_H_

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/offline_run.h"

namespace rips::ripsctl {

// `args[0]` is its name or path. Its output goes through files in a directory of this call's own;
// nothing comes from its standard input. The code is 128 if it did not exit by itself.
inline Result RunProgram(std::vector<std::string> args) {
  const TestDirectory directory;
  const std::string out = absl::StrCat(directory.path(), "/out");
  const std::string err = absl::StrCat(directory.path(), "/err");
  std::vector<char*> argv;
  for (std::string& arg : args) argv.push_back(arg.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, 0, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&actions, 1, out.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
  posix_spawn_file_actions_addopen(&actions, 2, err.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
  pid_t pid = 0;
  const int failed = posix_spawnp(&pid, argv[0], &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  EXPECT_EQ(failed, 0) << args[0];
  if (failed != 0) return {};
  int status = -1;
  EXPECT_EQ(waitpid(pid, &status, 0), pid);
  const auto read = [](const std::string& path) {
    std::ifstream in(path, std::ios::binary);
    return std::string(std::istreambuf_iterator<char>(in), {});
  };
  return {WIFEXITED(status) ? WEXITSTATUS(status) : 128, read(out), read(err)};
}

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RUN_PROGRAM_H_
