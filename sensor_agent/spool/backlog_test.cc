// The backlog with its jobs done at once on a real disk.
#include "sensor_agent/outbox/backlog.h"

#include <fcntl.h>
#include <sched.h>
#include <sys/mount.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/spool/spool_thread.h"
#include "services/base/clock.h"
#include "services/base/overloaded.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

namespace fs = std::filesystem;

const std::string kOwn(16, 'o');
const std::string kFormer(16, 'f');

// A backlog and its spool. Time passes only in Eventually.
class SpooledBacklog {
 public:
  SpooledBacklog(const BacklogOptions& options, const SpoolOptions& spool,
                 const std::string& incarnation)
      : backlog_(options, incarnation) {
    if (spool.disk_bytes == 0) return;
    absl::StatusOr<std::unique_ptr<Spool>> opened = Spool::Open(spool);
    backlog_.SetDisk({.bytes_max = opened.ok() ? spool.disk_bytes : 0, .refuses = !opened.ok()});
    if (!opened.ok()) return;
    spool_ = *std::move(opened);
    backlog_.Recover(spool_->Recover(), now_ns_);
    backlog_.On(SpoolReleased{.disk_bytes = spool_->bytes()});
  }

  // The backlog, its jobs done.
  Backlog* operator->() {
    while (spool_ != nullptr) {
      const std::optional<SpoolJob> job = backlog_.NextJob(now_ns_);
      if (!job.has_value()) break;
      std::visit(Overloaded{[&](const SpoolReleased& result) { backlog_.On(result); },
                            [&](auto result) { backlog_.On(std::move(result), now_ns_); }},
                 DoJob(*spool_, *job));
    }
    return &backlog_;
  }
  // How many observations found no place.
  uint64_t Stop() {
    backlog_.BeginStop();
    const uint64_t left = operator->()->Unwritten();
    if (spool_ != nullptr && left == 0) {
      EXPECT_THAT(spool_->MarkClean(), IsOk());
    }
    spool_.reset();
    return left;
  }
  // Until it is true, or 20 s: then false.
  bool Eventually(const std::function<bool()>& condition) {
    for (int i = 0; i < 20'000; ++i) {
      if (condition()) return true;
      now_ns_ += kNanosPerMilli;
    }
    return false;
  }
  int64_t now_ns() const { return now_ns_; }

 private:
  int64_t now_ns_ = 1;
  Backlog backlog_;
  std::unique_ptr<Spool> spool_;
};

class BacklogTest : public testing::Test {
 protected:
  BacklogTest() {
    std::string name =
        absl::StrCat(access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp", "/rips-backlog-XXXXXX");
    dir_ = mkdtemp(name.data());
    options_.memory_bytes = 4'000;
    spool_.dir = dir_ + "/spool";
    spool_.disk_bytes = 1 << 20;
    spool_.segment_bytes = 2'000;
    spool_.boot_id = std::string(16, 'b');
    options_.retry = absl::Milliseconds(10);
  }
  ~BacklogTest() override {
    backlog_.reset();
    std::error_code error;
    fs::remove_all(dir_, error);
  }

  void Start(const std::string& incarnation = kOwn) {
    backlog_.reset();
    backlog_ = std::make_unique<SpooledBacklog>(options_, spool_, incarnation);
  }
  Backlog& backlog() { return *backlog_->operator->(); }
  bool Eventually(const std::function<bool()>& condition) {
    return backlog_->Eventually(condition);
  }
  // "NNN...": batch number n of `bytes` bytes.
  static std::string Text(int n, size_t bytes = 100) {
    std::string text = absl::StrCat(n, ":");
    return text + std::string(bytes - text.size(), 'x');
  }
  void SetAside(int first, int last, Lane lane = Lane::kMessages) {
    for (int n = first; n <= last; ++n) {
      const StreamKey stream = backlog().Own(lane);
      backlog().Put(stream, backlog().NextSequence(stream), 2, n, Text(n));
    }
  }
  // Sends the next batch of the lane: "4:5 1,2" = batch 4 with sequences from 5 of two.
  std::string Send(Lane lane = Lane::kMessages) {
    std::optional<BacklogBatch> next;
    if (!Eventually([&] { return (next = backlog().Front(lane)).has_value(); })) return "nothing";
    backlog().MarkSent(next->stream);
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
    for (const auto& each : fs::directory_iterator(spool_.dir)) {
      if (each.path().extension() == ".seg") ++count;
    }
    return count;
  }
  std::vector<fs::path> SegmentPaths() const {
    std::vector<fs::path> paths;
    for (const auto& each : fs::directory_iterator(spool_.dir)) {
      if (each.path().extension() == ".seg") paths.push_back(each.path());
    }
    std::sort(paths.begin(), paths.end());
    return paths;
  }
  uint64_t TotalLost() {
    uint64_t lost = 0;
    for (const Loss& each : backlog().PopLosses()) {
      EXPECT_EQ(each.cause, LossCause::kSpoolLost);
      lost += each.count;
    }
    return lost;
  }

  std::string dir_;
  BacklogOptions options_;
  SpoolOptions spool_;
  std::unique_ptr<SpooledBacklog> backlog_;
  StreamKey last_;
};

TEST_F(BacklogTest, LittleStaysInMemoryAndGoesOutInOrder) {
  Start();
  SetAside(1, 3);
  EXPECT_THAT(SendAll(3), ElementsAre("1 at 1", "2 at 3", "3 at 5"));
  EXPECT_FALSE(backlog().Front(Lane::kMessages).has_value());
  EXPECT_EQ(Segments(), 0u);
  EXPECT_EQ(backlog().state().observations, 6u);
  EXPECT_EQ(backlog().state().oldest_ns, 1);

  EXPECT_THAT(backlog().Acknowledge(last_, 4), IsOk());
  EXPECT_EQ(backlog().state().observations, 2u);
  EXPECT_THAT(backlog().Acknowledge(last_, 6), IsOk());
  EXPECT_EQ(backlog().state().memory_bytes, 0u);
  SetAside(4, 4);
  EXPECT_EQ(Send(), "4 at 7");
}

TEST_F(BacklogTest, MuchGoesToDiskAndComesBackInOrderAndLeavesNoFile) {
  options_.read_ahead_bytes = 500;
  Start();
  SetAside(1, 300);
  ASSERT_TRUE(Eventually([&] { return backlog().state().memory_bytes <= 4'000; }));
  EXPECT_GT(Segments(), 1u);
  EXPECT_TRUE(backlog().HasRoom());

  for (int n = 1; n <= 300; ++n) {
    ASSERT_EQ(Send(), absl::StrCat(n, " at ", 2 * n - 1));
    if (n % 10 == 0) {
      ASSERT_THAT(backlog().Acknowledge(last_, 2 * static_cast<uint64_t>(n)), IsOk());
    }
  }
  EXPECT_TRUE(Eventually([&] { return Segments() == 0 && backlog().disk().bytes == 0; }));
  EXPECT_EQ(backlog().state().memory_bytes, 0u);
  EXPECT_EQ(TotalLost(), 0u);
}

TEST_F(BacklogTest, ANewConnectionSendsAgainWhatIsNotAcknowledgedAfterItsAcknowledgement) {
  Start();
  SetAside(1, 3);
  SendAll(3);
  ASSERT_THAT(backlog().Acknowledge(last_, 2), IsOk());

  EXPECT_THAT(backlog().Rewind(),
              ElementsAre(BacklogRange{.stream = last_, .first_sequence = 3, .last_sequence = 6}));
  EXPECT_FALSE(backlog().Front(Lane::kMessages).has_value()) << "before its acknowledgement";
  ASSERT_THAT(backlog().Acknowledge(last_, 4), IsOk());
  EXPECT_EQ(Send(), "3 at 5");
}

// What lies below it may have been sent on another connection, or live.
TEST_F(BacklogTest, AnAcknowledgementOfANumberThatWasNeverGivenIsRefused) {
  Start();
  SetAside(1, 3);
  EXPECT_EQ(Send(), "1 at 1");
  for (int i = 0; i < 2; ++i) {
    EXPECT_THAT(backlog().Acknowledge(last_, 7), StatusIs(absl::StatusCode::kInvalidArgument));
    EXPECT_EQ(backlog().state().observations, 6u);
    backlog().Rewind();
  }
}

TEST_F(BacklogTest, WhatIsLeftIsSentByTheNextProcessUnderItsNumbers) {
  Start(kFormer);
  SetAside(1, 3);
  backlog().Put({.incarnation = std::string(16, 'p'), .lane = Lane::kControl}, 41, 2, 9, Text(9));
  EXPECT_EQ(backlog_->Stop(), 0u);

  Start();
  SetAside(4, 4);

  const std::vector<BacklogRange> ranges = backlog().Rewind();
  ASSERT_THAT(ranges, SizeIs(3));
  for (const BacklogRange& each : ranges) {
    ASSERT_THAT(backlog().Acknowledge(each.stream, each.first_sequence - 1), IsOk());
  }
  EXPECT_EQ(Send(Lane::kControl), "9 at 41");
  EXPECT_THAT(SendAll(4), ElementsAre("1 at 1", "2 at 3", "3 at 5", "4 at 1"));
  EXPECT_EQ(last_.incarnation, kOwn);
  EXPECT_EQ(TotalLost(), 0u);
}

TEST_F(BacklogTest, WithoutADiskWhatIsLeftEndsWithTheProcess) {
  spool_.disk_bytes = 0;
  Start();
  SetAside(1, 3);
  EXPECT_FALSE(backlog().disk().bytes_max > 0);
  EXPECT_EQ(backlog_->Stop(), 6u);
  EXPECT_FALSE(fs::exists(spool_.dir));
}

TEST_F(BacklogTest, AProcessThatDiesLeavesAnUnknownLoss) {
  {
    auto spool = Spool::Open(spool_);
    ASSERT_THAT(spool, IsOk());
    (*spool)->Recover();
  }
  Start();
  EXPECT_EQ(TotalLost(), 1u);
}

TEST_F(BacklogTest, DamagedControlObservationsAreReportedUnderTheirNumbers) {
  spool_.segment_bytes = 1 << 20;
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

  for (const BacklogRange& each : backlog().Rewind()) {
    ASSERT_THAT(backlog().Acknowledge(each.stream, 0), IsOk());
  }
  EXPECT_THAT(SendAll(3, Lane::kControl), ElementsAre("1 at 1", "lost at 3", "3 at 5"));
  EXPECT_EQ(TotalLost(), 0u);
  EXPECT_EQ(backlog().state().unreadable, 2u);
  ASSERT_THAT(backlog().Acknowledge(last_, 6), IsOk());
  EXPECT_EQ(backlog().state().observations, 0u);
}

TEST_F(BacklogTest, DamagedMessagesAreAGapAndTheLastOnesALoss) {
  spool_.segment_bytes = 1 << 20;
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

  const std::vector<BacklogRange> ranges = backlog().Rewind();
  ASSERT_THAT(ranges, SizeIs(1));
  EXPECT_EQ(ranges[0].last_sequence, 6u) << "nothing is promised that cannot come";
  ASSERT_THAT(backlog().Acknowledge(ranges[0].stream, 0), IsOk());
  EXPECT_THAT(SendAll(2), ElementsAre("1 at 1", "3 at 5"));
  EXPECT_EQ(TotalLost(), 2u) << "of the fourth; the second shows in the numbers";
  EXPECT_EQ(backlog().state().unreadable, 4u);
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
    const std::vector<BacklogRange> ranges = backlog().Rewind();
    ASSERT_THAT(ranges, SizeIs(1));
    ASSERT_THAT(SegmentPaths(), SizeIs(3));
    fs::remove(SegmentPaths()[missing]);
    ASSERT_THAT(backlog().Acknowledge(ranges[0].stream, 0), IsOk());
    EXPECT_TRUE(Eventually([&] {
      if (backlog().Front(Lane::kMessages).has_value()) {
        ++batches_;
        Send();
      }
      return batches_ + backlog().state().unreadable / 2 == 40;
    }));
    EXPECT_GT(backlog().state().unreadable, 0u);
  }

  uint64_t batches_ = 0;
};

TEST_F(UnreadableBacklogTest, InTheMiddleTheNumbersTell) {
  Play(1);
  EXPECT_EQ(TotalLost(), 0u);
  ASSERT_THAT(backlog().Acknowledge(last_, 80), IsOk());
  EXPECT_EQ(backlog().state().observations, 0u);
}

TEST_F(UnreadableBacklogTest, AtTheEndALossTells) {
  Play(2);
  EXPECT_EQ(TotalLost(), backlog().state().unreadable);
  ASSERT_THAT(backlog().Acknowledge(last_, 2 * batches_), IsOk());
  EXPECT_EQ(backlog().state().observations, 0u);
}

TEST_F(BacklogTest, AFullDiskLeavesTheRestInMemoryUntilThereIsRoomAgain) {
  spool_.disk_bytes = 3'000;
  spool_.segment_bytes = 500;
  Start();
  int n = 0;
  ASSERT_TRUE(Eventually([&] {
    if (backlog().HasRoom()) SetAside(n + 1, n + 1), ++n;
    return !backlog().HasRoom() && backlog().state().disk_refuses;
  }));
  EXPECT_LE(backlog().disk().bytes, 3'000u);
  EXPECT_TRUE(backlog().ShouldShedPayloads());

  for (int i = 1; i <= n; ++i) {
    ASSERT_EQ(Send(), absl::StrCat(i, " at ", 2 * i - 1));
    ASSERT_THAT(backlog().Acknowledge(last_, 2 * static_cast<uint64_t>(i)), IsOk());
  }
  EXPECT_TRUE(backlog().HasRoom());
  EXPECT_TRUE(Eventually([&] { return !backlog().ShouldShedPayloads(); }));
  EXPECT_EQ(TotalLost(), 0u);
}

TEST_F(BacklogTest, WhatTheServerRefusesTwiceIsLostAndTheRestGoesOn) {
  Start();
  SetAside(1, 2);
  SetAside(11, 12, Lane::kControl);
  backlog().OnRefused(backlog_->now_ns());
  backlog().OnRefused(backlog_->now_ns());
  EXPECT_EQ(backlog().state().unreadable, 0u) << "none of it was underway";
  for (int i = 0; i < 2; ++i) {
    EXPECT_EQ(Send(), "1 at 1");
    EXPECT_EQ(Send(Lane::kControl), "11 at 1");
    backlog().OnRefused(backlog_->now_ns());
    for (const BacklogRange& each : backlog().Rewind()) {
      ASSERT_THAT(backlog().Acknowledge(each.stream, each.first_sequence - 1), IsOk());
    }
  }
  EXPECT_EQ(Send(), "2 at 3");
  EXPECT_THAT(SendAll(2, Lane::kControl), ElementsAre("lost at 1", "12 at 3"));
  EXPECT_EQ(backlog().state().unreadable, 4u);
}

TEST_F(BacklogTest, ADirectoryThatCannotBeUsedMeansMemory) {
  std::ofstream(spool_.dir) << "a file";
  Start();
  EXPECT_FALSE(backlog().disk().bytes_max > 0);
  EXPECT_TRUE(backlog().state().disk_refuses);
  SetAside(1, 1);
  EXPECT_EQ(Send(), "1 at 1");
}

// On a file system of 64 KiB in a mount namespace of its own, which ends with its thread.
TEST_F(BacklogTest, AFileSystemWithoutSpaceIsSurvived) {
  if (geteuid() != 0) GTEST_SKIP() << "mounting a small file system needs root";
  std::string skipped;
  std::thread([&] {
    fs::create_directories(spool_.dir);
    if (unshare(CLONE_NEWNS) != 0 ||
        mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        mount("tmpfs", spool_.dir.c_str(), "tmpfs", 0, "size=64k") != 0) {
      skipped = "no mount namespace here";
      return;
    }
    Start();
    int n = 0;
    EXPECT_TRUE(Eventually([&] {
      if (backlog().HasRoom()) SetAside(n + 1, n + 1), ++n;
      return !backlog().HasRoom() && backlog().state().disk_refuses;
    }));
    EXPECT_GT(backlog().disk().bytes, 10'000u);
    for (int i = 1; i <= n; ++i) {
      EXPECT_EQ(Send(), absl::StrCat(i, " at ", 2 * i - 1));
      EXPECT_THAT(backlog().Acknowledge(last_, 2 * static_cast<uint64_t>(i)), IsOk());
    }
    EXPECT_TRUE(backlog().HasRoom());
    EXPECT_EQ(TotalLost(), 0u);
    backlog_.reset();
  }).join();
  if (!skipped.empty()) GTEST_SKIP() << skipped;
}

}  // namespace
}  // namespace rips::sensor
