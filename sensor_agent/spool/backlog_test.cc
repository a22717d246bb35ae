#include "sensor_agent/spool/backlog.h"

#include <fcntl.h>
#include <sched.h>
#include <sys/mount.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/runtime/real_clock.h"

namespace rips::sensor {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

namespace fs = std::filesystem;

const std::string kOwn(16, 'o');
const std::string kFormer(16, 'f');

// Until it is true, or 20 s: then false.
bool Eventually(const std::function<bool()>& condition) {
  for (int i = 0; i < 20'000; ++i) {
    if (condition()) return true;
    absl::SleepFor(absl::Milliseconds(1));
  }
  return false;
}

class BacklogTest : public testing::Test {
 protected:
  BacklogTest() {
    std::string name =
        absl::StrCat(access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp", "/rips-backlog-XXXXXX");
    dir_ = mkdtemp(name.data());
    options_.memory_bytes = 4'000;
    options_.spool.dir = dir_ + "/spool";
    options_.spool.disk_bytes = 1 << 20;
    options_.spool.segment_bytes = 2'000;
    options_.spool.boot_id = std::string(16, 'b');
    options_.spool.now = clock_.Now();
    options_.retry = absl::Milliseconds(10);
  }
  ~BacklogTest() override {
    backlog_.reset();
    std::error_code error;
    fs::remove_all(dir_, error);
  }

  void Start(const std::string& incarnation = kOwn) {
    backlog_ = std::make_unique<Backlog>(options_, incarnation, &clock_, [] {});
    ASSERT_THAT(backlog_->Open(), IsOk());
    backlog_->Start();
    backlog_->WaitUntilRecovered();
  }
  // "NNN...": batch number n of `bytes` bytes.
  static std::string Text(int n, size_t bytes = 100) {
    std::string text = absl::StrCat(n, ":");
    return text + std::string(bytes - text.size(), 'x');
  }
  void SetAside(int first, int last, Lane lane = Lane::kMessages) {
    for (int n = first; n <= last; ++n) backlog_->SetAside(lane, 2, n, Text(n));
  }
  // Sends the next batch of the lane: "4:5 1,2" = batch 4 with sequences from 5 of two.
  std::string Send(Lane lane = Lane::kMessages) {
    std::optional<BacklogBatch> next;
    if (!Eventually([&] { return (next = backlog_->Front(lane)).has_value(); })) return "nothing";
    backlog_->MarkSent(next->stream);
    last_ = next->stream;
    const std::string text =
        next->bytes == nullptr ? "lost" : next->bytes->substr(0, next->bytes->find(':'));
    return absl::StrCat(text, " at ", next->first_sequence);
  }
  std::vector<std::string> SendAll(int count, Lane lane = Lane::kMessages) {
    std::vector<std::string> sent;
    for (int i = 0; i < count; ++i) sent.push_back(Send(lane));
    return sent;
  }
  size_t Segments() const {
    size_t count = 0;
    for (const auto& each : fs::directory_iterator(options_.spool.dir)) {
      if (each.path().extension() == ".seg") ++count;
    }
    return count;
  }
  std::vector<fs::path> SegmentPaths() const {
    std::vector<fs::path> paths;
    for (const auto& each : fs::directory_iterator(options_.spool.dir)) {
      if (each.path().extension() == ".seg") paths.push_back(each.path());
    }
    std::sort(paths.begin(), paths.end());
    return paths;
  }
  uint64_t TotalLost() {
    uint64_t lost = 0;
    for (const Loss& each : backlog_->TakeLosses()) {
      EXPECT_EQ(each.cause, LossCause::kSpoolLost);
      lost += each.count;
    }
    return lost;
  }

  RealClock clock_;
  std::string dir_;
  BacklogOptions options_ = {.spool = {.dir = ""}};
  std::unique_ptr<Backlog> backlog_;
  StreamKey last_;
};

TEST_F(BacklogTest, LittleStaysInMemoryAndGoesOutInOrder) {
  Start();
  SetAside(1, 3);
  EXPECT_THAT(SendAll(3), ElementsAre("1 at 1", "2 at 3", "3 at 5"));
  EXPECT_FALSE(backlog_->Front(Lane::kMessages).has_value());
  EXPECT_EQ(Segments(), 0u);
  EXPECT_EQ(backlog_->state().observations, 6u);
  EXPECT_EQ(backlog_->state().oldest_ns, 1);

  EXPECT_THAT(backlog_->Acknowledge(last_, 4), IsOk());
  EXPECT_EQ(backlog_->state().observations, 2u);
  EXPECT_THAT(backlog_->Acknowledge(last_, 6), IsOk());
  EXPECT_EQ(backlog_->state().memory_bytes, 0u);
  SetAside(4, 4);
  EXPECT_EQ(Send(), "4 at 7");
}

TEST_F(BacklogTest, MuchGoesToDiskAndComesBackInOrderAndLeavesNoFile) {
  options_.read_ahead_bytes = 500;
  Start();
  SetAside(1, 300);
  ASSERT_TRUE(Eventually([&] { return backlog_->state().memory_bytes <= 4'000; }));
  EXPECT_GT(Segments(), 1u);
  EXPECT_TRUE(backlog_->HasRoom());

  for (int n = 1; n <= 300; ++n) {
    ASSERT_EQ(Send(), absl::StrCat(n, " at ", 2 * n - 1));
    if (n % 10 == 0) {
      ASSERT_THAT(backlog_->Acknowledge(last_, 2 * static_cast<uint64_t>(n)), IsOk());
    }
  }
  EXPECT_TRUE(Eventually([&] { return Segments() == 0 && backlog_->state().disk_bytes == 0; }));
  EXPECT_EQ(backlog_->state().memory_bytes, 0u);
  EXPECT_EQ(TotalLost(), 0u);
}

TEST_F(BacklogTest, ANewConnectionSendsAgainWhatIsNotAcknowledgedAfterItsAcknowledgement) {
  Start();
  SetAside(1, 3);
  SendAll(3);
  ASSERT_THAT(backlog_->Acknowledge(last_, 2), IsOk());

  EXPECT_THAT(backlog_->Rewind(),
              ElementsAre(BacklogRange{.stream = last_, .first_sequence = 3, .last_sequence = 6}));
  EXPECT_FALSE(backlog_->Front(Lane::kMessages).has_value()) << "before its acknowledgement";
  ASSERT_THAT(backlog_->Acknowledge(last_, 4), IsOk());
  EXPECT_EQ(Send(), "3 at 5");
}

TEST_F(BacklogTest, AnAcknowledgementOfWhatWasNotSentIsRefused) {
  Start();
  SetAside(1, 3);
  EXPECT_EQ(Send(), "1 at 1");
  EXPECT_THAT(backlog_->Acknowledge(last_, 4), StatusIs(absl::StatusCode::kInvalidArgument));
  backlog_->Rewind();
  EXPECT_THAT(backlog_->Acknowledge(last_, 7), StatusIs(absl::StatusCode::kInvalidArgument))
      << "a number that was never given";
  EXPECT_EQ(backlog_->state().observations, 6u);
}

TEST_F(BacklogTest, WhatIsLeftIsSentByTheNextProcessUnderItsNumbers) {
  Start(kFormer);
  SetAside(1, 3);
  backlog_->Put({.incarnation = std::string(16, 'p'), .lane = Lane::kControl}, 41, 2, 9, Text(9));
  EXPECT_EQ(backlog_->Stop(), 0u);

  Start();
  SetAside(4, 4);

  const std::vector<BacklogRange> ranges = backlog_->Rewind();
  ASSERT_THAT(ranges, SizeIs(3));
  for (const BacklogRange& each : ranges) {
    ASSERT_THAT(backlog_->Acknowledge(each.stream, each.first_sequence - 1), IsOk());
  }
  EXPECT_EQ(Send(Lane::kControl), "9 at 41");
  EXPECT_THAT(SendAll(4), ElementsAre("1 at 1", "2 at 3", "3 at 5", "4 at 1"));
  EXPECT_EQ(last_.incarnation, kOwn);
  EXPECT_EQ(TotalLost(), 0u);
}

TEST_F(BacklogTest, WithoutADiskWhatIsLeftEndsWithTheProcess) {
  options_.spool.disk_bytes = 0;
  Start();
  SetAside(1, 3);
  EXPECT_FALSE(backlog_->on_disk());
  EXPECT_EQ(backlog_->Stop(), 6u);
  EXPECT_FALSE(fs::exists(options_.spool.dir));
}

TEST_F(BacklogTest, AProcessThatDiesLeavesAnUnknownLoss) {
  {
    auto spool = Spool::Open(options_.spool);
    ASSERT_THAT(spool, IsOk());
    (*spool)->Recover();
  }
  Start();
  EXPECT_EQ(TotalLost(), 1u);
}

TEST_F(BacklogTest, DamagedControlObservationsAreToldUnderTheirNumbers) {
  options_.spool.segment_bytes = 1 << 20;
  Start(kFormer);
  SetAside(1, 3, Lane::kControl);
  ASSERT_EQ(backlog_->Stop(), 0u);
  ASSERT_THAT(SegmentPaths(), SizeIs(1));
  {
    std::fstream file(SegmentPaths()[0], std::ios::in | std::ios::out | std::ios::binary);
    // In the second of three frames.
    file.seekp(kSegmentHeaderBytes + kFrameHeaderBytes + 100 + kFrameHeaderBytes + 5);
    file.put('?');
  }

  Start();

  for (const BacklogRange& each : backlog_->Rewind()) {
    ASSERT_THAT(backlog_->Acknowledge(each.stream, 0), IsOk());
  }
  EXPECT_THAT(SendAll(3, Lane::kControl), ElementsAre("1 at 1", "lost at 3", "3 at 5"));
  EXPECT_EQ(TotalLost(), 0u);
  EXPECT_EQ(backlog_->state().unreadable, 2u);
  ASSERT_THAT(backlog_->Acknowledge(last_, 6), IsOk());
  EXPECT_EQ(backlog_->state().observations, 0u);
}

TEST_F(BacklogTest, DamagedMessagesAreAGapAndTheLastOnesALoss) {
  options_.spool.segment_bytes = 1 << 20;
  Start(kFormer);
  SetAside(1, 4);
  ASSERT_EQ(backlog_->Stop(), 0u);
  {
    std::fstream file(SegmentPaths()[0], std::ios::in | std::ios::out | std::ios::binary);
    for (const int frame : {1, 3}) {
      file.seekp(static_cast<std::streamoff>(kSegmentHeaderBytes +
                                             frame * (kFrameHeaderBytes + 100) + 50));
      file.put('?');
    }
  }

  Start();

  const std::vector<BacklogRange> ranges = backlog_->Rewind();
  ASSERT_THAT(ranges, SizeIs(1));
  EXPECT_EQ(ranges[0].last_sequence, 6u) << "nothing is promised that cannot come";
  ASSERT_THAT(backlog_->Acknowledge(ranges[0].stream, 0), IsOk());
  EXPECT_THAT(SendAll(2), ElementsAre("1 at 1", "3 at 5"));
  EXPECT_EQ(TotalLost(), 2u) << "of the fourth; the second shows in the numbers";
  EXPECT_EQ(backlog_->state().unreadable, 4u);
}

// 60 observations in three segments, of which `missing` is deleted after they were found.
class UnreadableBacklogTest : public BacklogTest {
 protected:
  void Play(size_t missing) {
    Start(kFormer);
    SetAside(1, 40);
    ASSERT_EQ(backlog_->Stop(), 0u);
    options_.read_ahead_bytes = 1;
    Start();
    const std::vector<BacklogRange> ranges = backlog_->Rewind();
    ASSERT_THAT(ranges, SizeIs(1));
    ASSERT_THAT(SegmentPaths(), SizeIs(3));
    fs::remove(SegmentPaths()[missing]);
    ASSERT_THAT(backlog_->Acknowledge(ranges[0].stream, 0), IsOk());
    EXPECT_TRUE(Eventually([&] {
      if (backlog_->Front(Lane::kMessages).has_value()) {
        ++batches_;
        Send();
      }
      return batches_ + backlog_->state().unreadable / 2 == 40;
    }));
    EXPECT_GT(backlog_->state().unreadable, 0u);
  }

  uint64_t batches_ = 0;
};

TEST_F(UnreadableBacklogTest, InTheMiddleTheNumbersTell) {
  Play(1);
  EXPECT_EQ(TotalLost(), 0u);
  ASSERT_THAT(backlog_->Acknowledge(last_, 80), IsOk());
  EXPECT_EQ(backlog_->state().observations, 0u);
}

TEST_F(UnreadableBacklogTest, AtTheEndALossTells) {
  Play(2);
  EXPECT_EQ(TotalLost(), backlog_->state().unreadable);
  ASSERT_THAT(backlog_->Acknowledge(last_, 2 * batches_), IsOk());
  EXPECT_EQ(backlog_->state().observations, 0u);
}

TEST_F(BacklogTest, AFullDiskLeavesTheRestInMemoryUntilThereIsRoomAgain) {
  options_.spool.disk_bytes = 3'000;
  options_.spool.segment_bytes = 500;
  Start();
  int n = 0;
  ASSERT_TRUE(Eventually([&] {
    if (backlog_->HasRoom()) SetAside(n + 1, n + 1), ++n;
    return !backlog_->HasRoom() && backlog_->state().disk_refuses;
  }));
  EXPECT_LE(backlog_->state().disk_bytes, 3'000u);
  EXPECT_TRUE(backlog_->ShouldShedPayloads());

  for (int i = 1; i <= n; ++i) {
    ASSERT_EQ(Send(), absl::StrCat(i, " at ", 2 * i - 1));
    ASSERT_THAT(backlog_->Acknowledge(last_, 2 * static_cast<uint64_t>(i)), IsOk());
  }
  EXPECT_TRUE(backlog_->HasRoom());
  EXPECT_TRUE(Eventually([&] { return !backlog_->ShouldShedPayloads(); }));
  EXPECT_EQ(TotalLost(), 0u);
}

TEST_F(BacklogTest, WhatTheServerRefusesTwiceIsLostAndTheRestGoesOn) {
  Start();
  SetAside(1, 2);
  SetAside(11, 12, Lane::kControl);
  const absl::Status why = absl::InvalidArgumentError("nonsense");
  backlog_->Refused(why);
  backlog_->Refused(why);
  EXPECT_EQ(backlog_->state().unreadable, 0u) << "none of it was underway";
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(Send(), "1 at 1");
    EXPECT_EQ(Send(Lane::kControl), "11 at 1");
    backlog_->Refused(why);
    for (const BacklogRange& each : backlog_->Rewind()) {
      ASSERT_THAT(backlog_->Acknowledge(each.stream, each.first_sequence - 1), IsOk());
    }
  }
  EXPECT_EQ(Send(), "2 at 3");
  EXPECT_THAT(SendAll(2, Lane::kControl), ElementsAre("lost at 1", "12 at 3"));
  EXPECT_EQ(backlog_->state().unreadable, 4u);
}

TEST_F(BacklogTest, ASecondProcessOnTheDirectoryIsRefused) {
  Start();
  Backlog second(options_, kFormer, &clock_, [] {});
  EXPECT_THAT(second.Open(), StatusIs(absl::StatusCode::kFailedPrecondition));
}

TEST_F(BacklogTest, ADirectoryThatCannotBeUsedMeansMemory) {
  std::ofstream(options_.spool.dir) << "a file";
  Start();
  EXPECT_FALSE(backlog_->on_disk());
  EXPECT_TRUE(backlog_->state().disk_refuses);
  SetAside(1, 1);
  EXPECT_EQ(Send(), "1 at 1");
}

// A file system of 64 KiB that nobody else sees, until the thread that mounted it ends.
TEST_F(BacklogTest, AFileSystemWithoutSpaceIsSurvived) {
  if (geteuid() != 0) GTEST_SKIP() << "mounting a small file system needs root";
  std::string skipped;
  std::thread([&] {
    fs::create_directories(options_.spool.dir);
    if (unshare(CLONE_NEWNS) != 0 ||
        mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        mount("tmpfs", options_.spool.dir.c_str(), "tmpfs", 0, "size=64k") != 0) {
      skipped = "no mount namespace here";
      return;
    }
    Start();
    int n = 0;
    EXPECT_TRUE(Eventually([&] {
      if (backlog_->HasRoom()) SetAside(n + 1, n + 1), ++n;
      return !backlog_->HasRoom() && backlog_->state().disk_refuses;
    }));
    EXPECT_GT(backlog_->state().disk_bytes, 10'000u);
    for (int i = 1; i <= n; ++i) {
      EXPECT_EQ(Send(), absl::StrCat(i, " at ", 2 * i - 1));
      EXPECT_THAT(backlog_->Acknowledge(last_, 2 * static_cast<uint64_t>(i)), IsOk());
    }
    EXPECT_TRUE(backlog_->HasRoom());
    EXPECT_EQ(TotalLost(), 0u);
    backlog_.reset();
  }).join();
  if (!skipped.empty()) GTEST_SKIP() << skipped;
}

}  // namespace
}  // namespace rips::sensor
