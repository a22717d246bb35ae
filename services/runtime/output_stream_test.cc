#include "services/runtime/output_stream.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

#include "gtest/gtest.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/unique_fd.h"

namespace rips {
namespace {

// The exit code for `code` after printing `text` to `fd`; what it said goes to `error`.
int Print(int fd, const std::string& text, int code, std::string* error) {
  OutputStream out(fd);
  out << text;
  testing::internal::CaptureStderr();
  const int result = out.End(code);
  *error = testing::internal::GetCapturedStderr();
  return result;
}

TEST(OutputStreamTest, WritesAllInOrder) {
  int ends[2];
  ASSERT_EQ(pipe2(ends, O_CLOEXEC), 0);
  const UniqueFd in(ends[0]);
  {
    const UniqueFd out(ends[1]);
    std::string error;
    EXPECT_EQ(Print(out.get(), "a" + std::string(1'000, 'b') + "c", 3, &error), 3);
    EXPECT_EQ(error, "");
  }
  char bytes[2'000];
  EXPECT_EQ(std::string(bytes, static_cast<size_t>(read(in.get(), bytes, sizeof bytes))),
            "a" + std::string(1'000, 'b') + "c");
}

TEST(OutputStreamTest, AFullDiskIsAnErrorHoweverMuchIsPrinted) {
  const UniqueFd full(open("/dev/full", O_WRONLY | O_CLOEXEC));
  for (const size_t size : {size_t{1}, size_t{1} << 20}) {
    std::string error;
    EXPECT_EQ(Print(full.get(), std::string(size, 'x'), 0, &error), 1);
    EXPECT_EQ(error,
              "error: cannot write to standard output: No space left on device; the output is not "
              "complete\n");
    EXPECT_EQ(Print(full.get(), "x", 2, &error), 2) << "what was wrong before is worse";
  }
  std::string error;
  EXPECT_EQ(Print(full.get(), "", 0, &error), 0) << "nothing was lost";
}

TEST(OutputStreamTest, IsBadOnceItCannotWrite) {
  const UniqueFd full(open("/dev/full", O_WRONLY | O_CLOEXEC));
  OutputStream out(full.get());
  out << "x";
  EXPECT_TRUE(out.good());
  out << std::flush;
  EXPECT_FALSE(out.good());
}

TEST(OutputStreamTest, AReaderThatIsGoneIsNoError) {
  HandleSigpipe();
  int ends[2];
  ASSERT_EQ(pipe2(ends, O_CLOEXEC), 0);
  close(ends[0]);
  const UniqueFd out(ends[1]);
  std::string error;
  EXPECT_EQ(Print(out.get(), "x", 0, &error), kExitReaderGone);
  EXPECT_EQ(error, "");
  OutputStream closed(STDOUT_FILENO);
  closed.setstate(std::ios::badbit);
  EXPECT_EQ(closed.End(0), kExitReaderGone);
}

TEST(OutputStreamTest, AClosedDescriptorIsAnErrorAndGoesToNoFile) {
  const pid_t child = fork();
  if (child == 0) {
    close(STDIN_FILENO);
    close(STDOUT_FILENO);
    OpenStandardStreams();
    const int next = open("/dev/null", O_WRONLY | O_CLOEXEC);
    OutputStream out(STDOUT_FILENO);
    out << "x";
    _exit(next > STDERR_FILENO && out.End(0) == 1 ? 0 : 9);
  }
  int status = -1;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
}

}  // namespace
}  // namespace rips
