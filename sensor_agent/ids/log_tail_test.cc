#include "sensor_agent/ids/log_tail.h"

#include <poll.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/clock.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::ElementsAreArray;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class LogTailTest : public testing::Test {
 protected:
  LogTailTest() {
    std::string name = testing::TempDir() + "/log_tail_XXXXXX";
    dir_ = mkdtemp(name.data());
    path_ = dir_ + "/eve.json";
  }
  ~LogTailTest() override { fs::remove_all(dir_); }

  void Append(const std::string& path, absl::string_view text) {
    std::ofstream(path, std::ios::app | std::ios::binary) << text;
  }
  void Append(absl::string_view text) { Append(path_, text); }
  void Overwrite(const std::string& path, absl::string_view text) {
    std::ofstream(path, std::ios::trunc | std::ios::binary) << text;
  }
  // Appends through this as a writer that keeps the file open.
  std::ofstream Writer() { return std::ofstream(path_, std::ios::app | std::ios::binary); }

  LogTail Tail(std::optional<LogPosition> from = LogPosition(), LogTailLimits limits = {}) {
    return LogTail(path_, from, limits);
  }
  // Everything there is now.
  std::vector<std::string> Read(LogTail& tail) {
    std::vector<std::string> lines;
    int turns = 0;
    while (tail.Read(now_ns_, [&](absl::string_view line) { lines.emplace_back(line); })) {
      if (++turns > 10'000) {
        ADD_FAILURE() << "reading does not end";
        break;
      }
    }
    return lines;
  }
  // As another process that goes on there.
  std::vector<std::string> ReadFrom(std::optional<LogPosition> from) {
    LogTail tail = Tail(from);
    return Read(tail);
  }

  std::string dir_;
  std::string path_;
  int64_t now_ns_ = kNanosPerSecond;
};

// --- Lines

TEST_F(LogTailTest, GivesCompleteLines) {
  LogTail tail = Tail();
  Append("one\ntwo\r\n\nth");
  EXPECT_THAT(Read(tail), ElementsAre("one", "two", ""));
  Append("re");
  EXPECT_THAT(Read(tail), IsEmpty());
  Append("e\n");
  EXPECT_THAT(Read(tail), ElementsAre("three"));
  EXPECT_THAT(tail.status(), IsOk());
}

TEST_F(LogTailTest, EveryCutOfALineGivesTheSame) {
  const std::string text = "first line\nsecond\n";
  for (size_t cut = 0; cut <= text.size(); ++cut) {
    fs::remove(path_);
    LogTail tail = Tail();
    Append(text.substr(0, cut));
    std::vector<std::string> lines = Read(tail);
    Append(text.substr(cut));
    for (const std::string& line : Read(tail)) lines.push_back(line);
    EXPECT_THAT(lines, ElementsAre("first line", "second")) << cut;
  }
}

TEST_F(LogTailTest, WhatIsThereAtAFirstStartIsOld) {
  Append("old\nhalf of an old");
  LogTail tail = Tail(std::nullopt);
  EXPECT_THAT(Read(tail), IsEmpty());
  Append(" one\nnew\n");
  EXPECT_THAT(Read(tail), ElementsAre("new"));
  EXPECT_EQ(tail.counters().too_long, 0);
}

TEST_F(LogTailTest, AFileThatComesAfterTheFirstStartIsNew) {
  LogTail tail = Tail(std::nullopt);
  EXPECT_THAT(Read(tail), IsEmpty());
  EXPECT_THAT(tail.status(), StatusIs(absl::StatusCode::kNotFound));
  Append("new\n");
  EXPECT_THAT(Read(tail), ElementsAre("new"));
  EXPECT_THAT(tail.status(), IsOk());
}

TEST_F(LogTailTest, ALineAtTheLimitIsGivenAndOneBeyondIsCounted) {
  LogTail tail = Tail(LogPosition(), {.line_bytes = 1'000});
  Append(absl::StrCat(std::string(1'000, 'a'), "\n", std::string(1'001, 'b'), "\nc\n"));
  EXPECT_THAT(Read(tail), ElementsAre(std::string(1'000, 'a'), "c"));
  EXPECT_EQ(tail.counters().too_long, 1);
}

TEST_F(LogTailTest, ALineWithoutEndIsCountedOnceAndNotKept) {
  LogTail tail = Tail(LogPosition(), {.line_bytes = 1'000});
  for (int i = 0; i < 10; ++i) {
    Append(std::string(500, 'x'));
    EXPECT_THAT(Read(tail), IsEmpty());
  }
  Append("end\nnext\n");
  EXPECT_THAT(Read(tail), ElementsAre("next"));
  EXPECT_EQ(tail.counters().too_long, 1);
}

TEST_F(LogTailTest, TheDefaultLimitIsAMebibyte) {
  LogTail tail = Tail();
  Append(absl::StrCat(std::string(1 << 20, 'a'), "\n", std::string((1 << 20) + 1, 'b'), "\n"));
  EXPECT_THAT(Read(tail), ElementsAre(SizeIs(1 << 20)));
  EXPECT_EQ(tail.counters().too_long, 1);
}

TEST_F(LogTailTest, ATurnIsBounded) {
  LogTail tail = Tail(LogPosition(), {.turn_bytes = 100});
  std::vector<std::string> expected;
  for (int i = 0; i < 1'000; ++i) {
    expected.push_back(absl::StrCat("line ", i));
    Append(absl::StrCat(expected.back(), "\n"));
  }
  size_t lines = 0;
  EXPECT_TRUE(tail.Read(now_ns_, [&](absl::string_view) { ++lines; }));
  EXPECT_LE(lines, 20);
  EXPECT_THAT(Read(tail), SizeIs(1'000 - lines));
}

// --- What is done to logs

TEST_F(LogTailTest, RenamedAndLateLinesComeInOrder) {
  LogTail tail = Tail();
  std::vector<std::string> expected;
  std::vector<std::string> lines;
  const auto read = [&] {
    for (const std::string& line : Read(tail)) lines.push_back(line);
  };
  for (int i = 0; i < 6; ++i) {
    std::ofstream writer = Writer();
    writer << i << " before\n" << std::flush;
    read();
    fs::rename(path_, absl::StrCat(path_, ".", i));
    if (i % 2 == 0) read();
    writer << i << " late\n" << std::flush;
    if (i % 3 == 0) Append("");  // the new file is there, and empty
    read();
    writer << i << " later\n" << std::flush;
    expected.insert(expected.end(), {absl::StrCat(i, " before"), absl::StrCat(i, " late"),
                                     absl::StrCat(i, " later")});
  }
  Append("end\n");
  read();
  expected.push_back("end");
  EXPECT_THAT(lines, ElementsAreArray(expected));
  EXPECT_EQ(tail.counters().gaps, 0);
}

TEST_F(LogTailTest, LinesAfterTheNewFileBeganAreReadToo) {
  LogTail tail = Tail();
  std::ofstream writer = Writer();
  writer << "one\n" << std::flush;
  EXPECT_THAT(Read(tail), ElementsAre("one"));
  fs::rename(path_, path_ + ".1");
  Append("two\n");
  EXPECT_THAT(Read(tail), ElementsAre("two"));
  writer << "late\nhalf" << std::flush;
  EXPECT_THAT(Read(tail), ElementsAre("late"));
  now_ns_ += 6 * kNanosPerSecond;
  Read(tail);
  writer << "too late\n" << std::flush;
  EXPECT_THAT(Read(tail), IsEmpty());
  EXPECT_EQ(tail.counters().cut_off, 1) << "the half line";
}

TEST_F(LogTailTest, AFormerFileThatIsUsedForSomethingElseIsLeftAlone) {
  LogTail tail = Tail();
  Append("one\n");
  Read(tail);
  fs::rename(path_, path_ + ".1");
  Append("two\n");
  EXPECT_THAT(Read(tail), ElementsAre("two"));
  Overwrite(path_ + ".1", "something else\n");
  EXPECT_THAT(Read(tail), IsEmpty());
  Append("three\n");
  EXPECT_THAT(Read(tail), ElementsAre("three"));
}

TEST_F(LogTailTest, SeveralRotationsBetweenLooksAreReadInOrder) {
  LogTail tail = Tail();
  Append("0\n");
  EXPECT_THAT(Read(tail), ElementsAre("0"));
  std::vector<std::string> expected;
  for (int i = 1; i <= 5; ++i) {
    // As logrotate: the older ones move up.
    for (int n = i; n > 1; --n) {
      fs::rename(absl::StrCat(path_, ".", n - 1), absl::StrCat(path_, ".", n));
    }
    fs::rename(path_, path_ + ".1");
    Append(absl::StrCat(i, "\n"));
    expected.push_back(absl::StrCat(i));
  }
  EXPECT_THAT(Read(tail), ElementsAreArray(expected));
  EXPECT_EQ(tail.counters().gaps, 0);
}

TEST_F(LogTailTest, AWriterThatIsNeverToldOfARotationIsFollowed) {
  LogTail tail = Tail(LogPosition(), {.rotated_files = 2});
  std::ofstream writer = Writer();
  for (int i = 0; i < 5; ++i) {
    writer << i << "\n" << std::flush;
    EXPECT_THAT(Read(tail), ElementsAre(absl::StrCat(i)));
    fs::rename(path_, absl::StrCat(path_, ".", i));
    Append("");
    now_ns_ += 60 * kNanosPerSecond;
    EXPECT_THAT(Read(tail), IsEmpty());
  }
  Append("told\n");
  EXPECT_THAT(Read(tail), ElementsAre("told"));
  EXPECT_EQ(tail.counters().gaps, 0);
}

TEST_F(LogTailTest, ARotatedFileThatIsGoneIsAGap) {
  LogTail tail = Tail();
  Append("0\n");
  Read(tail);
  fs::rename(path_, path_ + ".1");
  Append("1\n");
  fs::rename(path_, path_ + ".2");
  fs::remove(path_ + ".2");
  Append("2\n");
  EXPECT_THAT(Read(tail), ElementsAre("2"));
  EXPECT_EQ(tail.counters().gaps, 1);
}

TEST_F(LogTailTest, OnlySoManyRotatedFilesWait) {
  LogTail tail = Tail(LogPosition(), {.rotated_files = 2});
  Append("0\n");
  Read(tail);
  for (int i = 1; i <= 4; ++i) {
    fs::rename(path_, absl::StrCat(path_, ".", i));
    Append(absl::StrCat(i, "\n"));
  }
  EXPECT_THAT(Read(tail), ElementsAre("1", "2", "4"));
  EXPECT_EQ(tail.counters().gaps, 1);
}

TEST_F(LogTailTest, CompressedAndRemovedAfterItWasReadIsNoGap) {
  LogTail tail = Tail();
  Append("0\n");
  Read(tail);
  fs::rename(path_, path_ + ".1");
  fs::remove(path_ + ".1");
  Append("1\n");
  EXPECT_THAT(Read(tail), ElementsAre("1"));
  EXPECT_EQ(tail.counters().gaps, 0);
}

TEST_F(LogTailTest, CopyTruncateBeginsAgain) {
  LogTail tail = Tail();
  for (int i = 0; i < 3; ++i) {
    Append(absl::StrCat("a rather long line ", i, "\nhalf"));
    EXPECT_THAT(Read(tail), ElementsAre(absl::StrCat("a rather long line ", i)));
    fs::copy_file(path_, absl::StrCat(path_, ".", i));
    fs::resize_file(path_, 0);
    if (i == 1) {
      EXPECT_THAT(Read(tail), IsEmpty());
    }
  }
  Append("short\n");
  EXPECT_THAT(Read(tail), ElementsAre("short"));
  now_ns_ += 60 * kNanosPerSecond;
  Read(tail);
  EXPECT_EQ(tail.counters().cut_off, 3);
}

TEST_F(LogTailTest, WhatWasCopiedBeforeItWasReadIsReadFromTheCopy) {
  LogTail tail = Tail();
  for (int i = 0; i < 3; ++i) {
    Append(absl::StrCat(i, " one\n", i, " tw"));
    EXPECT_THAT(Read(tail), ElementsAre(absl::StrCat(i, " one")));
    Append(absl::StrCat("o\n", i, " three\n"));
    fs::copy_file(path_, absl::StrCat(path_, ".", i));
    fs::resize_file(path_, 0);
    Append(absl::StrCat(i, " four\n"));
    EXPECT_THAT(Read(tail), ElementsAre(absl::StrCat(i, " two"), absl::StrCat(i, " three"),
                                        absl::StrCat(i, " four")));
  }
  EXPECT_EQ(tail.counters().cut_off, 0);
}

TEST_F(LogTailTest, CopiedAndTruncatedInTheMeantimeIsReadFromTheCopy) {
  LogTail tail = Tail();
  Append("one\ntwo\n");
  Read(tail);
  Append("three\n");
  fs::copy_file(path_, path_ + ".1");
  Overwrite(path_, "4\n");
  LogTail next = Tail(tail.position());
  EXPECT_THAT(Read(next), ElementsAre("three", "4"));
  EXPECT_EQ(next.counters().gaps, 0);
  // Files that only look alike by their name are none.
  Overwrite(path_ + ".2", "another text of that length\n");
  Overwrite(path_, "5\n");
  fs::remove(path_ + ".1");
  LogTail last = Tail(tail.position());
  EXPECT_THAT(Read(last), ElementsAre("5"));
  EXPECT_EQ(last.counters().gaps, 1);
}

TEST_F(LogTailTest, ATruncationThatGrewAgainIsNoticed) {
  LogTail tail = Tail();
  Append("one\ntwo\n");
  EXPECT_THAT(Read(tail), ElementsAre("one", "two"));
  Overwrite(path_, "three and more\nfour and more\n");
  EXPECT_THAT(Read(tail), ElementsAre("three and more", "four and more"));
}

TEST_F(LogTailTest, AHoleOfAWriterThatGoesOnWhereItWasIsSkipped) {
  LogTail tail = Tail();
  std::ofstream writer(path_, std::ios::binary);  // not appending
  writer << std::string(100'000, 'x') << "\n" << std::flush;
  EXPECT_THAT(Read(tail), ElementsAre(SizeIs(100'000)));
  fs::resize_file(path_, 0);
  writer << "one\n" << std::flush;
  EXPECT_THAT(Read(tail), ElementsAre("one"));
  writer << "two\n" << std::flush;
  EXPECT_THAT(Read(tail), ElementsAre("two"));
}

TEST_F(LogTailTest, UnlinkedItIsReadUntilThereIsANewOne) {
  LogTail tail = Tail();
  std::ofstream writer = Writer();
  writer << "one\n" << std::flush;
  EXPECT_THAT(Read(tail), ElementsAre("one"));
  fs::remove(path_);
  writer << "two\n" << std::flush;
  EXPECT_THAT(Read(tail), ElementsAre("two"));
  EXPECT_THAT(tail.status(), StatusIs(absl::StatusCode::kNotFound));
  Append("three\n");
  EXPECT_THAT(Read(tail), ElementsAre("three"));
  EXPECT_THAT(tail.status(), IsOk());
}

TEST_F(LogTailTest, ReplacedByACopyGoesOnInIt) {
  LogTail tail = Tail();
  Append("one\ntwo\n");
  EXPECT_THAT(Read(tail), ElementsAre("one", "two"));
  // As `sed -i` does it.
  Overwrite(dir_ + "/sedXXX", "one\ntwo\nthree\n");
  fs::rename(dir_ + "/sedXXX", path_);
  EXPECT_THAT(Read(tail), ElementsAre("three"));
  Append("four\n");
  EXPECT_THAT(Read(tail), ElementsAre("four"));
}

TEST_F(LogTailTest, ReplacedBySomethingElseBeginsAnew) {
  LogTail tail = Tail();
  Append("one\ntwo\n");
  Read(tail);
  Overwrite(dir_ + "/other", "1\n2\n3\n4\n5\n");
  fs::rename(dir_ + "/other", path_);
  EXPECT_THAT(Read(tail), ElementsAre("1", "2", "3", "4", "5"));
}

TEST_F(LogTailTest, RenamedBackItIsNotReadAgain) {
  for (const int64_t later_ns : {int64_t{0}, 60 * kNanosPerSecond}) {
    fs::remove(path_);
    LogTail tail = Tail();
    Append("one\n");
    EXPECT_THAT(Read(tail), ElementsAre("one"));
    fs::rename(path_, path_ + ".1");
    Append("two\n");
    EXPECT_THAT(Read(tail), ElementsAre("two"));
    now_ns_ += later_ns;
    EXPECT_THAT(Read(tail), IsEmpty());
    fs::rename(path_, path_ + ".2");
    fs::rename(path_ + ".1", path_);
    Append("three\n");
    EXPECT_THAT(Read(tail), ElementsAre("three"));
    now_ns_ += later_ns;
    fs::rename(path_, path_ + ".1");
    fs::rename(path_ + ".2", path_);
    Append("four\n");
    EXPECT_THAT(Read(tail), ElementsAre("four"));
    EXPECT_EQ(tail.counters().gaps, 0);
  }
}

TEST_F(LogTailTest, ADirectoryThatComesLater) {
  path_ = dir_ + "/sub/eve.json";
  LogTail tail = Tail(std::nullopt);
  EXPECT_THAT(Read(tail), IsEmpty());
  fs::create_directory(dir_ + "/sub");
  Append("one\n");
  EXPECT_THAT(Read(tail), ElementsAre("one"));
  fs::rename(dir_ + "/sub", dir_ + "/away");
  fs::create_directory(dir_ + "/sub");
  Read(tail);
  Append("two\n");
  EXPECT_THAT(Read(tail), ElementsAre("two"));
  // Its events are still seen.
  fs::rename(path_, path_ + ".1");
  Append("three\n");
  fs::rename(path_, path_ + ".2");
  Append("four\n");
  EXPECT_THAT(Read(tail), ElementsAre("three", "four"));
}

TEST_F(LogTailTest, WhatIsNoRegularFileIsRefused) {
  ASSERT_EQ(mkfifo(path_.c_str(), 0600), 0);
  LogTail tail = Tail();
  EXPECT_THAT(Read(tail), IsEmpty());
  EXPECT_THAT(tail.status(),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("is no regular file")));
}

TEST_F(LogTailTest, NewBytesAndRotationsWake) {
  Append("one\n");
  LogTail tail = Tail();
  Read(tail);
  const auto wakes = [&] {
    pollfd event = {.fd = tail.wake_fd(), .events = POLLIN, .revents = 0};
    return poll(&event, 1, 0) == 1;
  };
  Read(tail);
  EXPECT_FALSE(wakes());
  Append("two\n");
  EXPECT_TRUE(wakes());
  Read(tail);
  EXPECT_FALSE(wakes());
  fs::rename(path_, path_ + ".1");
  EXPECT_TRUE(wakes());
  Read(tail);
  Append("three\n");
  EXPECT_TRUE(wakes());
  Read(tail);
  Append("four\n");
  EXPECT_TRUE(wakes());
}

TEST_F(LogTailTest, WithoutEventsItSeesWhatIsThere) {
  LogTail tail = Tail(LogPosition(), {.events = false});
  EXPECT_EQ(tail.wake_fd(), -1);
  Append("one\n");
  EXPECT_THAT(Read(tail), ElementsAre("one"));
  Append("two\n");
  fs::rename(path_, path_ + ".1");
  Append("three\n");
  EXPECT_THAT(Read(tail), ElementsAre("two", "three"));
}

// --- Going on in another process

TEST_F(LogTailTest, GoesOnAtThePosition) {
  LogTail tail = Tail();
  Append("one\ntwo\nhal");
  EXPECT_THAT(Read(tail), ElementsAre("one", "two"));
  Append("f\nthree\n");
  EXPECT_THAT(ReadFrom(tail.position()), ElementsAre("half", "three"));
}

TEST_F(LogTailTest, PositionsOfLinesAreThoseBeforeThem) {
  LogTail tail = Tail();
  std::vector<LogPosition> positions;
  std::vector<std::string> lines;
  for (int i = 0; i < 200; ++i) {
    lines.push_back(absl::StrCat("line ", i, std::string(static_cast<size_t>(i), '.')));
    Append(absl::StrCat(lines.back(), "\n"));
    if (i % 7 != 0) continue;
    tail.Read(now_ns_, [&](absl::string_view) { positions.push_back(tail.line_position()); });
  }
  tail.Read(now_ns_, [&](absl::string_view) { positions.push_back(tail.line_position()); });
  ASSERT_THAT(positions, SizeIs(200));
  for (size_t i = 0; i < positions.size(); ++i) {
    EXPECT_THAT(ReadFrom(positions[i]),
                ElementsAreArray(lines.begin() + static_cast<ptrdiff_t>(i), lines.end()));
  }
}

TEST_F(LogTailTest, InsideALineThatWasTooLongItGoesOnBehindIt) {
  LogTail tail = Tail(LogPosition(), {.line_bytes = 1'000});
  Append(std::string(2'000, 'x'));
  Read(tail);
  Append("end\nnext\n");
  EXPECT_THAT(ReadFrom(tail.position()), ElementsAre("next"));
}

TEST_F(LogTailTest, FindsTheFileThatWasRenamedInTheMeantime) {
  LogTail tail = Tail();
  Append("one\ntwo\n");
  Read(tail);
  Append("three\n");
  fs::rename(path_, path_ + ".1");
  Append("four\n");
  LogTail next = Tail(tail.position());
  EXPECT_THAT(Read(next), ElementsAre("three", "four"));
  EXPECT_EQ(next.counters().gaps, 0);
}

TEST_F(LogTailTest, RenamedSeveralTimesInTheMeantimeIsAGap) {
  LogTail tail = Tail();
  Append("one\n");
  Read(tail);
  Append("two\n");
  fs::rename(path_, path_ + ".1");
  Append("three\n");
  fs::rename(path_, path_ + ".2");
  // Coarse clocks give both the same time.
  fs::last_write_time(path_ + ".2", fs::last_write_time(path_ + ".1") + std::chrono::seconds(1));
  Append("four\n");
  LogTail next = Tail(tail.position());
  EXPECT_THAT(Read(next), ElementsAre("two", "four"));
  EXPECT_EQ(next.counters().gaps, 1);
}

TEST_F(LogTailTest, RenamedAndNothingNewYet) {
  LogTail tail = Tail();
  Append("one\n");
  Read(tail);
  fs::rename(path_, path_ + ".1");
  LogTail next = Tail(tail.position());
  EXPECT_THAT(Read(next), IsEmpty());
  Append("two\n");
  EXPECT_THAT(Read(next), ElementsAre("two"));
  EXPECT_EQ(next.counters().gaps, 0);
}

TEST_F(LogTailTest, CompressedInTheMeantimeIsAGap) {
  LogTail tail = Tail();
  Append("one\n");
  Read(tail);
  fs::remove(path_);
  Append("another\n");
  LogTail next = Tail(tail.position());
  EXPECT_THAT(Read(next), ElementsAre("another"));
  EXPECT_EQ(next.counters().gaps, 1);
}

TEST_F(LogTailTest, TruncatedInTheMeantimeIsReadFromTheBeginningAndAGap) {
  LogTail tail = Tail();
  Append("one\ntwo\n");
  Read(tail);
  Overwrite(path_, "3\n");
  LogTail next = Tail(tail.position());
  EXPECT_THAT(Read(next), ElementsAre("3"));
  EXPECT_EQ(next.counters().gaps, 1);
}

TEST_F(LogTailTest, AnInodeThatWasUsedAgainIsNoticed) {
  LogTail tail = Tail();
  Append("one\ntwo\n");
  Read(tail);
  // The same inode, longer, other bytes.
  Overwrite(path_, "some other text that is longer\n");
  LogTail next = Tail(tail.position());
  EXPECT_THAT(Read(next), ElementsAre("some other text that is longer"));
  EXPECT_EQ(next.counters().gaps, 1);
}

TEST_F(LogTailTest, CopiedInTheMeantimeGoesOn) {
  LogTail tail = Tail();
  Append("one\ntwo\n");
  Read(tail);
  fs::copy_file(path_, dir_ + "/copy");
  fs::remove(path_);
  fs::rename(dir_ + "/copy", path_);
  Append("three\n");
  LogTail next = Tail(tail.position());
  EXPECT_THAT(Read(next), ElementsAre("three"));
  EXPECT_EQ(next.counters().gaps, 0);
}

TEST_F(LogTailTest, AbsentBeforeAndThereNowIsNew) {
  LogTail tail = Tail(std::nullopt);
  Read(tail);
  ASSERT_TRUE(tail.position().has_value());
  EXPECT_EQ(tail.position()->inode, 0);
  Append("one\n");
  EXPECT_THAT(ReadFrom(tail.position()), ElementsAre("one"));
}

TEST_F(LogTailTest, AbsentNowAndThereBeforeIsAGapAndThenNew) {
  LogTail tail = Tail();
  Append("one\n");
  Read(tail);
  fs::remove(path_);
  LogTail next = Tail(tail.position());
  EXPECT_THAT(Read(next), IsEmpty());
  EXPECT_EQ(next.counters().gaps, 1);
  Append("two\n");
  EXPECT_THAT(Read(next), ElementsAre("two"));
}

TEST_F(LogTailTest, HostilePositionsDoNoHarm) {
  Append("one\n");
  struct stat status;
  ASSERT_EQ(stat(path_.c_str(), &status), 0);
  for (const uint64_t offset : {uint64_t{5}, uint64_t{1} << 40, UINT64_MAX, uint64_t{1} << 63}) {
    EXPECT_THAT(ReadFrom(LogPosition{.device = 1, .inode = status.st_ino, .offset = offset}),
                ElementsAre("one"))
        << offset;
  }
}

}  // namespace
}  // namespace rips::sensor
