#include "services/runtime/log_writer.h"

#include <fcntl.h>
#include <limits.h>
#include <poll.h>
#include <signal.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include <cstdint>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips {
namespace {

using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::MatchesRegex;
using ::testing::Not;

constexpr absl::Duration kLong = absl::Minutes(1);

struct TestPipe {
  explicit TestPipe(int flags = 0) {
    int ends[2];
    EXPECT_EQ(pipe2(ends, O_CLOEXEC | flags), 0);
    read = UniqueFd(ends[0]);
    write = UniqueFd(ends[1]);
  }
  // Until nothing more can be written without waiting.
  void Fill() const {
    while (TryWriteToLog(write.get(), std::string(PIPE_BUF - 1, 'x') + "\n")) {
    }
  }
  // A line and its line break, waiting for them.
  std::string ReadLine() const {
    std::string line;
    char c = 0;
    while (::read(read.get(), &c, 1) == 1) {
      line += c;
      if (c == '\n') break;
    }
    return line;
  }
  // The lines until `last`.
  std::vector<std::string> ReadUntil(const std::string& last) const {
    std::vector<std::string> lines;
    for (std::string line = ReadLine(); !line.empty() && line != last; line = ReadLine()) {
      lines.push_back(line);
    }
    return lines;
  }
  UniqueFd Out() const { return UniqueFd(fcntl(write.get(), F_DUPFD_CLOEXEC, 3)); }

  UniqueFd read, write;
};

std::vector<std::string> PopLines(LogQueue& queue) {
  std::vector<std::string> lines = absl::StrSplit(queue.Pop(SIZE_MAX), '\n', absl::SkipEmpty());
  return lines;
}

TEST(LogQueueTest, KeepsTheOrderOverAllLevels) {
  LogQueue queue({});
  queue.Push(LogLevel::kError, "a\n");
  queue.Push(LogLevel::kDebug, "b\n");
  queue.Push(LogLevel::kInfo, "c\n");
  queue.Push(LogLevel::kDebug, "d\n");

  EXPECT_THAT(PopLines(queue), ElementsAre("a", "b", "c", "d"));
  EXPECT_THAT(PopLines(queue), IsEmpty());
  EXPECT_EQ(queue.size(), 0);
  EXPECT_EQ(queue.dropped(), 0);
}

TEST(LogQueueTest, DropsTheOldestLinesOfTheLowestLevel) {
  LogQueue queue({.lines = 4, .bytes = 1'000});
  queue.Push(LogLevel::kInfo, "old info\n");
  queue.Push(LogLevel::kError, "old error\n");
  queue.Push(LogLevel::kDebug, "debug\n");
  queue.Push(LogLevel::kInfo, "info\n");
  queue.Push(LogLevel::kWarning, "warning\n");
  queue.Push(LogLevel::kError, "error\n");

  EXPECT_EQ(queue.dropped(), 2);
  EXPECT_THAT(PopLines(queue), ElementsAre("old error", "info", "warning", "error"));
}

TEST(LogQueueTest, DropsANewLineIfAllOthersMatterMore) {
  LogQueue queue({.lines = 2, .bytes = 1'000});
  queue.Push(LogLevel::kError, "a\n");
  queue.Push(LogLevel::kWarning, "b\n");
  queue.Push(LogLevel::kInfo, "c\n");

  EXPECT_EQ(queue.dropped(), 1);
  EXPECT_THAT(PopLines(queue), ElementsAre("a", "b"));
}

TEST(LogQueueTest, BoundsBytes) {
  LogQueue queue({.lines = 100, .bytes = 10});
  queue.Push(LogLevel::kInfo, "1234\n");
  queue.Push(LogLevel::kInfo, "5678\n");
  queue.Push(LogLevel::kInfo, "9\n");
  EXPECT_EQ(queue.dropped(), 1);
  queue.Push(LogLevel::kError, std::string(11, 'x'));

  EXPECT_EQ(queue.dropped(), 4);
  EXPECT_EQ(queue.size(), 0);
  queue.Push(LogLevel::kInfo, "5678\n");
  EXPECT_EQ(queue.size(), 1);
}

TEST(LogQueueTest, PopsWholeLines) {
  LogQueue queue({});
  queue.Push(LogLevel::kInfo, "123456\n");
  queue.Push(LogLevel::kInfo, "7\n");
  queue.Push(LogLevel::kInfo, "8\n");
  queue.Push(LogLevel::kInfo, "9\n");

  EXPECT_EQ(queue.Pop(4), "123456\n");
  EXPECT_EQ(queue.Pop(5), "7\n8\n");
  EXPECT_EQ(queue.Pop(5), "9\n");
  EXPECT_EQ(queue.Pop(5), "");
}

TEST(LogLineTest, HasTimeLevelAndMessage) {
  EXPECT_THAT(FormatLogLine(LogLevel::kWarning, "gone robot=r1"),
              MatchesRegex("20[0-9-]+T[0-9:]+\\.[0-9][0-9][0-9]Z warning gone robot=r1\n"));
}

TEST(LogWriterTest, WritesInOrderWhatCameBeforeItStartedToo) {
  const TestPipe pipe;
  LogWriter writer(pipe.Out());
  writer.Push(LogLevel::kInfo, "a\n");
  writer.Push(LogLevel::kDebug, "b\n");
  ASSERT_TRUE(writer.Start());
  writer.Push(LogLevel::kError, "c\n");

  EXPECT_EQ(pipe.ReadLine(), "a\n");
  EXPECT_EQ(pipe.ReadLine(), "b\n");
  EXPECT_EQ(pipe.ReadLine(), "c\n");
  EXPECT_TRUE(writer.Flush(kLong, kLong));
  EXPECT_EQ(writer.dropped(), 0);
}

// Neither Push nor Flush waits for a reader that has stopped; what was dropped is counted and said.
TEST(LogWriterTest, APipeThatNobodyReadsStopsNoOther) {
  const TestPipe pipe;
  pipe.Fill();
  LogWriter writer(pipe.Out(), UniqueFd(), {.lines = 8, .bytes = 1'000});
  ASSERT_TRUE(writer.Start());

  for (int i = 0; i < 1'000; ++i) writer.Push(LogLevel::kInfo, absl::StrCat("info ", i, "\n"));
  writer.Push(LogLevel::kError, "error\n");
  EXPECT_FALSE(writer.Flush(kLong, absl::Milliseconds(5)));
  EXPECT_FALSE(writer.Flush(absl::Milliseconds(5), kLong));

  const uint64_t dropped = writer.dropped();
  EXPECT_GE(dropped, 1'001 - 8 - 8);
  writer.Push(LogLevel::kError, "end\n");
  std::vector<std::string> lines = pipe.ReadUntil("end\n");
  uint64_t written = 0;
  uint64_t said = 0;
  for (const std::string& line : lines) {
    if (line.find("info ") == 0 || line == "error\n") ++written;
    const size_t at = line.find(" lines=");
    if (line.find("warning log lines dropped") != std::string::npos && at != std::string::npos) {
      said += std::stoull(line.substr(at + 7));
    }
  }
  EXPECT_TRUE(writer.Flush(kLong, kLong));
  EXPECT_EQ(written + writer.dropped(), 1'001);
  EXPECT_EQ(said, writer.dropped());
  EXPECT_EQ(lines.back(), "error\n");
}

TEST(LogWriterTest, FlushWaitsForAReaderThatReads) {
  const TestPipe pipe;
  pipe.Fill();
  LogWriter writer(pipe.Out());
  ASSERT_TRUE(writer.Start());
  writer.Push(LogLevel::kInfo, "end\n");
  std::thread reader([&] { pipe.ReadUntil("end\n"); });

  EXPECT_TRUE(writer.Flush(kLong, kLong));
  reader.join();
}

// The process ignores SIGPIPE or not: the thread has it blocked.
TEST(LogWriterTest, AReaderThatDiesEndsNothing) {
  TestPipe pipe;
  LogWriter writer(pipe.Out());
  ASSERT_TRUE(writer.Start());
  pipe.read.Reset();

  writer.Push(LogLevel::kInfo, "a\n");
  EXPECT_TRUE(writer.Flush(kLong, kLong));
  writer.Push(LogLevel::kInfo, "b\n");
  EXPECT_TRUE(writer.Flush(kLong, kLong));
  EXPECT_EQ(writer.dropped(), 2);
}

TEST(LogWriterTest, AFullDiskLosesCountedLines) {
  UniqueFd full(open("/dev/full", O_WRONLY | O_CLOEXEC));
  ASSERT_GE(full.get(), 0);
  LogWriter writer(std::move(full));
  ASSERT_TRUE(writer.Start());
  for (int i = 0; i < 5; ++i) {
    writer.Push(LogLevel::kInfo, "a\n");
    EXPECT_TRUE(writer.Flush(kLong, kLong));
  }
  EXPECT_EQ(writer.dropped(), 5);
}

TEST(LogWriterTest, WaitsWhereTheDescriptorDoesNotBlock) {
  const TestPipe pipe(O_NONBLOCK);
  pipe.Fill();
  LogWriter writer(pipe.Out());
  ASSERT_TRUE(writer.Start());
  writer.Push(LogLevel::kInfo, "a\n");
  EXPECT_FALSE(writer.Flush(kLong, absl::Milliseconds(5)));
  fcntl(pipe.read.get(), F_SETFL, 0);

  EXPECT_THAT(pipe.ReadUntil("a\n"), Not(IsEmpty()));
  EXPECT_TRUE(writer.Flush(kLong, kLong));
  EXPECT_EQ(writer.dropped(), 0);
}

TEST(LogWriterTest, WritesWhatOthersWriteAsItIs) {
  const TestPipe pipe;
  TestPipe others(O_NONBLOCK);
  LogWriter writer(pipe.Out(), std::move(others.read));
  ASSERT_TRUE(writer.Start());
  WriteToLog(others.write.get(), "free(): inva");
  WriteToLog(others.write.get(), "lid pointer\nnext\n");

  EXPECT_EQ(pipe.ReadLine(), "free(): invalid pointer\n");
  EXPECT_EQ(pipe.ReadLine(), "next\n");
  WriteToLog(others.write.get(), "no line break");
  EXPECT_EQ(pipe.ReadLine(), "no line break\n");
  WriteToLog(others.write.get(), std::string(PIPE_BUF + 10, 'x') + "\n");
  EXPECT_EQ(pipe.ReadLine(), std::string(PIPE_BUF - 1, 'x') + "\n");
  EXPECT_EQ(pipe.ReadLine(), std::string(11, 'x') + "\n");
  EXPECT_TRUE(writer.Flush(kLong, kLong));
}

// Their pipe is full, and the log's: they lose lines, and wait for nothing.
TEST(LogWriterTest, OthersWaitForNothing) {
  const TestPipe pipe;
  pipe.Fill();
  TestPipe others(O_NONBLOCK);
  LogWriter writer(pipe.Out(), std::move(others.read), {.lines = 4, .bytes = 1'000});
  ASSERT_TRUE(writer.Start());
  writer.Push(LogLevel::kWarning, "ours\n");
  for (int i = 0; i < 20'000; ++i) {
    [[maybe_unused]] const ssize_t written = write(others.write.get(), "theirs\n", 7);
  }

  EXPECT_THAT(pipe.ReadUntil("ours\n"), Not(IsEmpty()));
}

TEST(LogWriterTest, AForkedChildWritesOnlyWhatNeedsNoWaiting) {
  const TestPipe pipe;
  LogWriter writer(pipe.Out());
  ASSERT_TRUE(writer.Start());
  const auto child = [&](const char* line) {
    writer.BeforeFork();
    const pid_t pid = fork();
    if (pid == 0) {
      writer.AfterForkInChild();
      writer.Push(LogLevel::kInfo, line);
      _exit(writer.Flush(kLong, kLong) ? static_cast<int>(writer.dropped()) : 100);
    }
    writer.AfterForkInParent();
    int status = 0;
    EXPECT_EQ(waitpid(pid, &status, 0), pid);
    return WIFEXITED(status) ? WEXITSTATUS(status) : 200;
  };

  EXPECT_EQ(child("child\n"), 0);
  EXPECT_EQ(pipe.ReadLine(), "child\n");
  pipe.Fill();
  EXPECT_EQ(child("lost\n"), 1);
  writer.Push(LogLevel::kInfo, "parent\n");
  EXPECT_THAT(pipe.ReadUntil("parent\n"), Each(HasSubstr("x\n")));
}

TEST(LogWriterTest, ItsThreadTakesNoSignal) {
  const TestPipe pipe;
  LogWriter writer(pipe.Out());
  ASSERT_TRUE(writer.Start());
  sigset_t mine;
  pthread_sigmask(SIG_SETMASK, nullptr, &mine);
  EXPECT_FALSE(sigismember(&mine, SIGUSR1));  // of this thread it is as it was

  sigset_t usr1;
  sigemptyset(&usr1);
  sigaddset(&usr1, SIGUSR1);
  pthread_sigmask(SIG_BLOCK, &usr1, nullptr);
  kill(getpid(), SIGUSR1);  // would end the process if a thread took it
  const timespec now = {};
  EXPECT_EQ(sigtimedwait(&usr1, nullptr, &now), SIGUSR1);
  pthread_sigmask(SIG_UNBLOCK, &usr1, nullptr);
}

}  // namespace
}  // namespace rips
