// What a log loses when it is truncated, and that a rotation which loses nothing is no gap.
#include <fcntl.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/ids/change_counter.h"
#include "sensor_agent/ids/log_tail.h"
#include "services/base/clock.h"
#include "services/runtime/unique_fd.h"

namespace rips::sensor {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

// As long as a line of an IDS is at least; each is another one, of the same length.
std::string TimedLine(int number) {
  return absl::StrCat("11/21/2026-10:11:12.", 100'000 + number, "  [**] [1:", 1'000 + number, "]");
}

class TruncatedLogTest : public testing::Test {
 protected:
  TruncatedLogTest() {
    std::string name = testing::TempDir() + "/truncated_log_XXXXXX";
    top_ = mkdtemp(name.data());
    fs::create_directories(top_ + "/logs");
    fs::create_directories(top_ + "/elsewhere");
    path_ = top_ + "/logs/fast.log";
  }
  ~TruncatedLogTest() override { fs::remove_all(top_); }

  // An IDS, which keeps its log open: one write for each line.
  void OpenWriter() { writer_ = std::ofstream(path_, std::ios::app | std::ios::binary); }
  void Write(const std::string& line) { writer_ << line << "\n" << std::flush; }
  // A followed log of which `lines` lines have been read.
  LogTail Followed(int lines = 3, LogTailLimits limits = {}) {
    OpenWriter();
    LogTail tail(path_, LogPosition(), limits);
    for (int i = 0; i < lines; ++i) Write(TimedLine(i));
    EXPECT_THAT(Read(tail), SizeIs(lines));
    return tail;
  }
  std::vector<std::string> Read(LogTail& tail) {
    std::vector<std::string> lines;
    while (tail.Read(kNanosPerSecond, [&](absl::string_view line) { lines.emplace_back(line); })) {
    }
    return lines;
  }

  struct Way {
    const char* name;
    std::function<void(const std::string& path)> truncate;
  };
  const std::vector<Way> ways_ = {
      {"truncate(2)", [](const std::string& path) { fs::resize_file(path, 0); }},
      {"a shell's >", [](const std::string& path) { std::ofstream(path, std::ios::trunc); }},
      {"logrotate",
       [](const std::string& path) {
         const int fd = open(path.c_str(), O_RDWR);
         std::string copied(1'000'000, '\0');
         EXPECT_GT(read(fd, copied.data(), copied.size()), 0);
         EXPECT_EQ(ftruncate(fd, 0), 0);
         close(fd);
       }},
  };

  std::string top_;
  std::string path_;
  std::ofstream writer_;
};

TEST_F(TruncatedLogTest, WhatWasReadToItsEndIsNoGap) {
  for (const Way& way : ways_) {
    fs::remove(path_);
    LogTail tail = Followed();
    for (int night = 1; night <= 30; ++night) {
      fs::copy_file(path_, top_ + "/elsewhere/copy", fs::copy_options::overwrite_existing);
      way.truncate(path_);
      if (night % 2 == 0) {
        EXPECT_THAT(Read(tail), IsEmpty()) << way.name;
      }
      Write(TimedLine(night * 10));
      EXPECT_THAT(Read(tail), ElementsAre(TimedLine(night * 10))) << way.name;
      // More at once than was there before.
      Write(absl::StrCat(TimedLine(night * 10 + 1), std::string(200, '.')));
      EXPECT_THAT(Read(tail), SizeIs(1)) << way.name;
    }
    EXPECT_EQ(tail.counters().gaps, 0) << way.name;
    EXPECT_EQ(tail.counters().cut_off, 0) << way.name;
    EXPECT_EQ(tail.counters().truncated, 30) << way.name;
  }
}

TEST_F(TruncatedLogTest, UnreadLinesAreAGap) {
  for (const Way& way : ways_) {
    for (const int unread : {1, 2, 100}) {
      fs::remove(path_);
      LogTail tail = Followed();
      for (int i = 0; i < unread; ++i) Write(TimedLine(100 + i));
      fs::copy_file(path_, top_ + "/elsewhere/copy", fs::copy_options::overwrite_existing);
      way.truncate(path_);
      EXPECT_THAT(Read(tail), IsEmpty()) << way.name;
      EXPECT_EQ(tail.counters().gaps, 1) << way.name << unread;
      Write(TimedLine(500));
      EXPECT_THAT(Read(tail), ElementsAre(TimedLine(500))) << way.name;
      EXPECT_EQ(tail.counters().gaps, 1) << way.name;
    }
  }
}

TEST_F(TruncatedLogTest, UnreadLinesAreAGapWhateverStandsThereBy) {
  for (const Way& way : ways_) {
    for (const int after : {1, 2, 50}) {
      fs::remove(path_);
      LogTail tail = Followed();
      Write(TimedLine(100));
      way.truncate(path_);
      for (int i = 0; i < after; ++i) Write(TimedLine(200 + i));
      EXPECT_THAT(Read(tail), SizeIs(after)) << way.name;
      EXPECT_EQ(tail.counters().gaps, 1) << way.name << after;
    }
  }
}

TEST_F(TruncatedLogTest, WhatATurnDidNotReachIsAGap) {
  LogTail tail = Followed(1, {.turn_bytes = 100});
  for (int i = 0; i < 100; ++i) Write(TimedLine(i));
  EXPECT_TRUE(tail.Read(kNanosPerSecond, [](absl::string_view) {}));
  fs::resize_file(path_, 0);
  Read(tail);
  EXPECT_EQ(tail.counters().gaps, 1);
}

// Of a log that a new process goes on in.
TEST_F(TruncatedLogTest, WhatWasThereAtAStartAndNotReachedIsAGap) {
  LogTail before = Followed(1);
  std::string many;
  for (int i = 0; i < 100; ++i) absl::StrAppend(&many, TimedLine(i), "\n");
  writer_ << many << std::flush;
  LogTail tail(path_, before.position(), {.turn_bytes = 100});
  EXPECT_TRUE(tail.Read(kNanosPerSecond, [](absl::string_view) {}));
  fs::resize_file(path_, 0);
  Read(tail);
  EXPECT_EQ(tail.counters().gaps, 1);
}

TEST_F(TruncatedLogTest, ACopyBesideItLosesNothing) {
  LogTail tail = Followed();
  Write(TimedLine(100));
  fs::copy_file(path_, path_ + "-20261128");
  fs::resize_file(path_, 0);
  Write(TimedLine(101));
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(100), TimedLine(101)));
  EXPECT_EQ(tail.counters().gaps, 0);
  EXPECT_EQ(tail.counters().truncated, 1);
}

TEST_F(TruncatedLogTest, ACopyOfBeforeHidesNoGap) {
  LogTail tail = Followed();
  fs::copy_file(path_, path_ + ".bak");
  Write(TimedLine(100));
  fs::resize_file(path_, 0);
  EXPECT_THAT(Read(tail), IsEmpty());
  EXPECT_EQ(tail.counters().gaps, 1);
}

TEST_F(TruncatedLogTest, ALogThatWasEmptyLosesWhatWasWrittenSince) {
  OpenWriter();
  LogTail tail(path_, LogPosition());
  EXPECT_THAT(Read(tail), IsEmpty());
  fs::resize_file(path_, 0);
  EXPECT_THAT(Read(tail), IsEmpty());
  EXPECT_EQ(tail.counters().gaps, 0);
  Write(TimedLine(1));
  fs::resize_file(path_, 0);
  EXPECT_THAT(Read(tail), IsEmpty());
  EXPECT_EQ(tail.counters().gaps, 1);
  Write(TimedLine(2));
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(2)));
  EXPECT_EQ(tail.counters().gaps, 1);
}

TEST_F(TruncatedLogTest, ShortenedItIsNotReadAgain) {
  const size_t line = TimedLine(0).size() + 1;
  LogTail tail = Followed(20);
  fs::resize_file(path_, 12 * line);
  EXPECT_THAT(Read(tail), IsEmpty());
  Write(TimedLine(100));
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(100)));
  EXPECT_EQ(tail.counters().gaps, 0);
  EXPECT_EQ(tail.counters().cut_off, 0);

  Write(TimedLine(101));  // unread
  fs::resize_file(path_, 10 * line);
  EXPECT_THAT(Read(tail), IsEmpty());
  EXPECT_EQ(tail.counters().gaps, 1);

  // In the middle of a line, which takes the next one with it.
  fs::resize_file(path_, 9 * line + 5);
  EXPECT_THAT(Read(tail), IsEmpty());
  Write(TimedLine(102));
  Write(TimedLine(103));
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(103)));
  EXPECT_EQ(tail.counters().cut_off, 1);
  EXPECT_EQ(tail.counters().truncated, 3);
}

TEST_F(TruncatedLogTest, DeletedAndMadeAgainBetweenLooks) {
  LogTail tail = Followed();
  const auto again = [&](int number) {
    fs::remove(path_);
    OpenWriter();
    Write(TimedLine(number));
  };
  again(100);
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(100)));
  EXPECT_EQ(tail.counters().gaps, 0) << "the first was read to its end";
  again(200);
  again(201);
  again(202);
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(202)));
  EXPECT_EQ(tail.counters().gaps, 2);
}

TEST_F(TruncatedLogTest, ReplacedTwiceBetweenLooks) {
  LogTail tail = Followed();
  for (const int number : {1, 2}) {
    std::ofstream(path_ + ".new") << TimedLine(100 + number) << "\n";
    fs::rename(path_ + ".new", path_);
  }
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(102)));
  EXPECT_EQ(tail.counters().gaps, 1);
}

TEST_F(TruncatedLogTest, ReplacedItsUnreadRestComesFirst) {
  LogTail tail = Followed();
  Write(TimedLine(100));
  Write(TimedLine(101));
  std::ofstream(path_ + ".new") << TimedLine(200) << "\n";
  fs::rename(path_ + ".new", path_);
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(100), TimedLine(101), TimedLine(200)));
  EXPECT_EQ(tail.counters().gaps, 0);
}

TEST_F(TruncatedLogTest, TruncatedAndRenamedAtOnce) {
  for (const bool unread : {false, true}) {
    fs::remove(path_);
    LogTail tail = Followed();
    if (unread) Write(TimedLine(100));
    fs::resize_file(path_, 0);
    fs::rename(path_, path_ + ".1");
    OpenWriter();
    Write(TimedLine(200));
    EXPECT_THAT(Read(tail), ElementsAre(TimedLine(200)));
    EXPECT_EQ(tail.counters().gaps, unread ? 1 : 0);
  }
}

TEST_F(TruncatedLogTest, WithoutEventsThatNothingWasLostCannotBeKnown) {
  LogTail tail = Followed(3, {.events = false});
  fs::resize_file(path_, 0);
  EXPECT_THAT(Read(tail), IsEmpty());
  EXPECT_EQ(tail.counters().gaps, 1);
}

TEST_F(TruncatedLogTest, BehindALinkItIsTheSame) {
  const std::string real = path_;
  std::ofstream(real, std::ios::app);
  path_ = top_ + "/elsewhere/link.log";
  fs::create_symlink(real, path_);
  LogTail tail = Followed();
  fs::resize_file(real, 0);
  Write(TimedLine(50));
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(50)));
  EXPECT_EQ(tail.counters().gaps, 0);
  Write(TimedLine(51));
  fs::resize_file(real, 0);
  EXPECT_THAT(Read(tail), IsEmpty());
  EXPECT_EQ(tail.counters().gaps, 1);
}

TEST_F(TruncatedLogTest, ALineThatNeverEndedIsCountedOnce) {
  LogTail tail = Followed(3, {.line_bytes = 1'000});
  // The disk is full, then somebody makes room.
  writer_ << std::string(5'000, 'x') << std::flush;
  EXPECT_THAT(Read(tail), IsEmpty());
  fs::resize_file(path_, 0);
  EXPECT_THAT(Read(tail), IsEmpty());
  Write(TimedLine(50));
  EXPECT_THAT(Read(tail), ElementsAre(TimedLine(50)));
  EXPECT_EQ(tail.counters().too_long, 1);
  EXPECT_EQ(tail.counters().gaps, 0);
}

class ChangeCounterTest : public TruncatedLogTest {
 protected:
  ChangeCounterTest() {
    OpenWriter();
    fd_ = UniqueFd(open(path_.c_str(), O_RDONLY));
    changes_.Watch(fd_.get());
    changes_.WasReadToEnd();
  }
  // Since the last call.
  std::optional<uint64_t> Changes() {
    changes_.Look();
    const std::optional<uint64_t> changes = changes_.changes();
    changes_.WasReadToEnd();
    return changes;
  }

  UniqueFd fd_;
  ChangeCounter changes_;
};

TEST_F(ChangeCounterTest, CountsEachWriteAndTruncation) {
  EXPECT_EQ(Changes(), 0);
  for (int i = 0; i < 1'000; ++i) Write("x");
  fs::resize_file(path_, 0);
  EXPECT_EQ(Changes(), 1'001);
  std::ofstream(path_ + ".other") << "not this one" << std::flush;
  EXPECT_EQ(Changes(), 0);
  fs::rename(path_, path_ + ".1");
  Write("x");
  Write("x");
  EXPECT_EQ(Changes(), 2);
  fs::rename(path_ + ".1", top_ + "/elsewhere/1");
  Write("x");
  Write("x");
  EXPECT_EQ(Changes(), std::nullopt) << "it has left the directory";
}

TEST_F(ChangeCounterTest, AddsUpUntilItWasRead) {
  Write("x");
  changes_.Look();
  Write("x");
  changes_.Look();
  EXPECT_EQ(changes_.changes(), 2);
  changes_.Watch(fd_.get());
  Write("x");
  changes_.Look();
  EXPECT_EQ(changes_.changes(), std::nullopt) << "it was not read to its end yet";
  EXPECT_EQ(Changes(), std::nullopt);
  changes_.Stop();
  EXPECT_EQ(Changes(), std::nullopt);
}

TEST_F(ChangeCounterTest, MoreThanTheKernelHoldsIsNotKnown) {
  size_t limit = 0;
  ASSERT_TRUE(std::ifstream("/proc/sys/fs/inotify/max_queued_events") >> limit);
  for (size_t i = 0; i < limit; ++i) Write("x");
  EXPECT_EQ(Changes(), std::nullopt);
  Write("x");
  EXPECT_EQ(Changes(), 1);
}

}  // namespace
}  // namespace rips::sensor
