#include "mode_actuator/steps/program/program_file.h"

#include <fcntl.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <fstream>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"

namespace rips::actuator {
namespace {

using ::testing::HasSubstr;

class ProgramPathTest : public ::testing::Test {
 protected:
  ProgramPathTest() {
    char name[] = "/tmp/rips-path-XXXXXX";
    dir_ = mkdtemp(name);
    chmod(dir_.c_str(), 0755);
    mkdir((dir_ + "/bin").c_str(), 0755);
    std::ofstream(dir_ + "/bin/run") << "#!/bin/sh\n";
    chmod((dir_ + "/bin").c_str(), 0755);
    chmod((dir_ + "/bin/run").c_str(), 0755);
    root_fd_ = open(dir_.c_str(), O_PATH | O_DIRECTORY | O_CLOEXEC);
  }
  ~ProgramPathTest() override {
    close(root_fd_);
    [[maybe_unused]] const int ended = system(("rm -rf " + dir_).c_str());
  }
  absl::Status Check(absl::string_view path = "/bin/run") {
    return CheckProgramPath(root_fd_, path);
  }

  std::string dir_;
  int root_fd_ = -1;
};

TEST_F(ProgramPathTest, FindsEachWayOthersCouldChangeIt) {
  if (geteuid() != 0) GTEST_SKIP() << "making files of root needs root";
  EXPECT_THAT(Check(), IsOk());
  const auto denied = [](const char* why) {
    return StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr(why));
  };
  const std::string run = dir_ + "/bin/run";

  chmod(run.c_str(), 0775);
  EXPECT_THAT(Check(), denied("`/bin/run` can be written by others"));
  chmod(run.c_str(), 0757);
  EXPECT_THAT(Check(), denied("`/bin/run` can be written by others"));
  chmod(run.c_str(), 0644);
  EXPECT_THAT(Check(), denied("`/bin/run` is not executable"));
  chmod(run.c_str(), 0755);
  chmod((dir_ + "/bin").c_str(), 0775);
  EXPECT_THAT(Check(), denied("`/bin` can be written by others"));
  chmod((dir_ + "/bin").c_str(), 01777);
  EXPECT_THAT(Check(), denied("`/bin` can be written by others"));
  chmod((dir_ + "/bin").c_str(), 0755);
  chmod(dir_.c_str(), 0777);
  EXPECT_THAT(Check(), denied("`/` can be written by others"));
  chmod(dir_.c_str(), 0755);
  if (!RootMay({CAP_CHOWN})) GTEST_SKIP() << "giving a file away needs CAP_CHOWN";
  ASSERT_EQ(chown(run.c_str(), 12'345, 0), 0);
  EXPECT_THAT(Check(), denied("`/bin/run` is not owned by root"));
  ASSERT_EQ(chown(run.c_str(), 0, 0), 0);
  EXPECT_THAT(Check(), IsOk());
}

TEST_F(ProgramPathTest, RefusesLinksAndOddPaths) {
  if (geteuid() != 0) GTEST_SKIP() << "making files of root needs root";
  ASSERT_EQ(symlink("run", (dir_ + "/bin/link").c_str()), 0);
  ASSERT_EQ(symlink("bin", (dir_ + "/sbin").c_str()), 0);
  const auto denied = StatusIs(absl::StatusCode::kPermissionDenied);
  EXPECT_THAT(Check("/bin/link"), denied);
  EXPECT_THAT(Check("/sbin/run"), denied);
  EXPECT_THAT(Check("bin/run"), denied);
  EXPECT_THAT(Check(""), denied);
  EXPECT_THAT(Check("/"), denied);
  EXPECT_THAT(Check("/bin/../bin/run"), denied);
  EXPECT_THAT(Check("/bin/./run"), denied);
  EXPECT_THAT(Check("//bin/run"), denied);
  EXPECT_THAT(Check("/bin/run/"), denied);
  EXPECT_THAT(Check("/bin"), denied);
  EXPECT_THAT(Check("/bin/nothing"), StatusIs(absl::StatusCode::kNotFound));
}

TEST_F(ProgramPathTest, WhatWasOpenedStaysThatFile) {
  if (geteuid() != 0) GTEST_SKIP() << "making files of root needs root";
  const auto file = OpenProgram(root_fd_, "/bin/run");
  ASSERT_THAT(file, IsOk());
  ASSERT_EQ(rename((dir_ + "/bin/run").c_str(), (dir_ + "/bin/old").c_str()), 0);
  std::ofstream(dir_ + "/bin/run") << "#!/bin/evil\n";
  char start[10] = {};
  ASSERT_EQ(pread(file->get(), start, 9, 0), 9);
  EXPECT_STREQ(start, "#!/bin/sh");
  EXPECT_THAT(OpenProgram(root_fd_, "/bin/nothing"), StatusIs(absl::StatusCode::kNotFound));
}

TEST_F(ProgramPathTest, TheSha256IsOfTheWholeFile) {
  // sha256sum of an empty file, and of 200,000 times `x`.
  const std::string path = dir_ + "/data";
  std::ofstream(path) << "";
  const UniqueFd file(open(path.c_str(), O_RDONLY | O_CLOEXEC));
  EXPECT_THAT(
      CheckSha256(file.get(), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"),
      IsOk());
  std::ofstream(path) << std::string(200'000, 'x');
  EXPECT_THAT(
      CheckSha256(file.get(), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"),
      StatusIs(absl::StatusCode::kPermissionDenied,
               HasSubstr("the file's SHA-256 is 91e3faafd322bcdf")));
  ASSERT_EQ(truncate(path.c_str(), kHashedBytesMax + 1), 0);
  EXPECT_THAT(CheckSha256(file.get(), ""),
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("exceeds limit 67108864")));
}

}  // namespace
}  // namespace rips::actuator
