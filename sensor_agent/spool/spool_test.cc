#include "sensor_agent/spool/spool.h"

#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/base/test_rights.h"
#include "services/runtime/atomic_file.h"

namespace rips::sensor {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

namespace fs = std::filesystem;

const StreamKey kMessages = {.incarnation = std::string(16, 'm'), .lane = Lane::kMessages};
const StreamKey kControl = {.incarnation = std::string(16, 'm'), .lane = Lane::kControl};

class SpoolTest : public testing::Test {
 protected:
  SpoolTest() {
    // In memory, if possible: these tests write thousands of files through.
    std::string name =
        absl::StrCat(access("/dev/shm", W_OK) == 0 ? "/dev/shm" : "/tmp", "/rips-spool-XXXXXX");
    dir_ = mkdtemp(name.data());
    options_.dir = dir_ + "/spool";
    options_.boot_id = std::string(16, 'b');
    options_.now = {.boottime_ns = 1'000, .unix_ns = 1'001'000};
  }
  ~SpoolTest() override {
    spool_.reset();
    std::error_code error;
    fs::remove_all(dir_, error);
  }

  Recovered Open() {
    auto spool = Spool::Open(options_);
    EXPECT_THAT(spool, IsOk());
    spool_ = *std::move(spool);
    return spool_->Recover();
  }
  // As the next process would.
  Recovered Reopen() {
    spool_.reset();
    return Open();
  }
  SpoolRecord Append(const StreamKey& stream, uint64_t first, uint32_t count,
                     const std::string& payload) {
    auto record = spool_->Append(
        stream, {.first_sequence = first, .count = count, .oldest_ns = 500, .payload = payload});
    EXPECT_THAT(record, IsOk());
    return record.ok() ? *record : SpoolRecord{};
  }
  std::vector<fs::path> Segments() const {
    std::vector<fs::path> paths;
    for (const auto& each : fs::directory_iterator(options_.dir)) {
      if (each.path().extension() == ".seg") paths.push_back(each.path());
    }
    std::sort(paths.begin(), paths.end());
    return paths;
  }
  // "c1+2 one" for each record: lane, first sequence, count, payload.
  std::vector<std::string> Texts(const Recovered& recovered) const {
    std::vector<std::string> texts;
    for (const SpoolRecord& each : recovered.records) {
      const auto payload = spool_->Read(each);
      texts.push_back(absl::StrCat(each.stream.lane == Lane::kControl ? "c" : "m",
                                   each.first_sequence, "+", each.count, " ",
                                   payload.ok() ? *payload : payload.status().ToString()));
    }
    return texts;
  }

  std::string dir_;
  SpoolOptions options_;
  std::unique_ptr<Spool> spool_;
};

TEST_F(SpoolTest, WhatWasAppendedIsThereForTheNextProcess) {
  EXPECT_FALSE(Open().unknown_lost);
  Append(kMessages, 1, 2, "one");
  Append(kControl, 5, 1, "two");
  Append(kMessages, 3, 1, "three");
  ASSERT_THAT(spool_->MarkClean(), IsOk());

  const Recovered recovered = Reopen();

  EXPECT_THAT(Texts(recovered), ElementsAre("m1+2 one", "m3+1 three", "c5+1 two"));
  EXPECT_THAT(recovered.gaps, IsEmpty());
  EXPECT_FALSE(recovered.unknown_lost);
  EXPECT_THAT(recovered.problems, IsEmpty());
  EXPECT_EQ(recovered.records[0].oldest_ns, 500);
}

TEST_F(SpoolTest, AProcessThatEndedOtherwiseLeavesItsFramesAndAnUnknownLoss) {
  Open();
  Append(kMessages, 1, 2, "one");

  const Recovered recovered = Reopen();

  EXPECT_THAT(Texts(recovered), ElementsAre("m1+2 one"));
  EXPECT_TRUE(recovered.unknown_lost);
  EXPECT_THAT(absl::StrJoin(recovered.problems, "\n"), HasSubstr("did not end in order"));
}

TEST_F(SpoolTest, AProcessThatDiedWithoutFramesIsTold) {
  Open();
  EXPECT_TRUE(Reopen().unknown_lost);
}

TEST_F(SpoolTest, SegmentsGoWithTheirLastRecord) {
  options_.segment_bytes = 200;
  Open();
  std::vector<SpoolRecord> records;
  for (uint64_t i = 1; i <= 6; ++i) {
    records.push_back(Append(kMessages, i, 1, std::string(50, 'x')));
  }
  const size_t all = Segments().size();
  ASSERT_GT(all, 2u);
  for (const SpoolRecord& each : records) spool_->Release(each);
  EXPECT_THAT(Segments(), IsEmpty());
  EXPECT_EQ(spool_->bytes(), 0u);
  Append(kMessages, 7, 1, "on");
  EXPECT_THAT(Segments(), SizeIs(1));
}

TEST_F(SpoolTest, TheDiskLimitRefusesAndReleasingMakesRoom) {
  options_.segment_bytes = 100;
  options_.disk_bytes = 1'000;
  Open();
  std::vector<SpoolRecord> records;
  absl::Status refused;
  for (uint64_t i = 1; refused.ok() && i < 100; ++i) {
    const auto record =
        spool_->Append(kMessages, {.first_sequence = i, .count = 1, .payload = "0123456789"});
    refused = record.status();
    if (record.ok()) records.push_back(*record);
  }
  EXPECT_TRUE(absl::IsResourceExhausted(refused)) << refused;
  EXPECT_THAT(refused.message(), HasSubstr("the limit is 1000"));
  EXPECT_LE(spool_->bytes(), 1'000u);
  ASSERT_THAT(spool_->MarkClean(), IsOk());
  EXPECT_LE(spool_->bytes(), 1'000u) << "seals have room, too";
  for (const SpoolRecord& each : records) spool_->Release(each);
  EXPECT_THAT(
      spool_->Append(kMessages, {.first_sequence = 50, .count = 1, .payload = "0123456789"}),
      IsOk());
}

TEST_F(SpoolTest, ASecondProcessIsRefused) {
  Open();
  const auto second = Spool::Open(options_);
  EXPECT_TRUE(absl::IsFailedPrecondition(second.status())) << second.status();
  EXPECT_THAT(second.status().message(), HasSubstr("another process uses the spool"));
}

TEST_F(SpoolTest, ADirectoryThatIsNoneIsUnavailable) {
  std::ofstream(options_.dir) << "a file";
  EXPECT_TRUE(absl::IsUnavailable(Spool::Open(options_).status()));
}

TEST_F(SpoolTest, AnUnwritableOrUnreadableDirectoryIsRefusedAtOnce) {
  // Root may write everywhere, so another user does it.
  const bool root = RootMay({CAP_DAC_OVERRIDE});
  if (root && !RootMay({CAP_SETUID})) GTEST_SKIP() << "becoming another user needs CAP_SETUID";
  ASSERT_EQ(chmod(dir_.c_str(), 0755), 0);
  fs::create_directories(options_.dir);
  ASSERT_EQ(chmod(options_.dir.c_str(), root ? 0700 : 0500), 0);
  if (root) {
    ASSERT_EQ(seteuid(65'534), 0);
  }
  const auto spool = Spool::Open(options_);
  if (root) {
    ASSERT_EQ(seteuid(0), 0);
  }
  chmod(options_.dir.c_str(), 0700);
  EXPECT_TRUE(absl::IsUnavailable(spool.status())) << spool.status();
  EXPECT_THAT(spool.status().message(), HasSubstr("Permission denied"));
}

TEST_F(SpoolTest, TheDirectoryIsOursAlone) {
  Open();
  struct stat status = {};
  ASSERT_EQ(stat(options_.dir.c_str(), &status), 0);
  EXPECT_EQ(status.st_mode & 0777, 0700u);
}

TEST_F(SpoolTest, TimesOfAnotherBootAreConvertedByTheWallClock) {
  Open();
  Append(kMessages, 1, 1, "one");  // at 500 ns of a boot that was 1'000 ns old at unix 1'001'000
  ASSERT_THAT(spool_->MarkClean(), IsOk());
  options_.boot_id = std::string(16, 'c');
  options_.now = {.boottime_ns = 100, .unix_ns = 1'002'000};

  const Recovered recovered = Reopen();

  ASSERT_THAT(recovered.records, SizeIs(1));
  // Taken at unix 1'000'500, which is 1'500 ns ago.
  EXPECT_EQ(recovered.records[0].oldest_ns, 100 - 1'500);
  EXPECT_EQ(recovered.records[0].time_shift_ns, 100 - 1'500 - 500);
}

TEST_F(SpoolTest, OldIncarnationsBeyondTheLimitAreGivenUp) {
  options_.incarnations = 2;
  Open();
  for (const char letter : {'a', 'b', 'c'}) {
    Append({.incarnation = std::string(16, letter), .lane = Lane::kMessages}, 1, 1, {letter});
  }
  ASSERT_THAT(spool_->MarkClean(), IsOk());

  const Recovered recovered = Reopen();

  EXPECT_THAT(Texts(recovered), ElementsAre("m1+1 b", "m1+1 c"));
  EXPECT_TRUE(recovered.unknown_lost);
  EXPECT_THAT(Segments(), SizeIs(2));
}

TEST_F(SpoolTest, OtherFilesInTheDirectoryAreLeftAlone) {
  Open();
  Append(kMessages, 1, 1, "one");
  ASSERT_THAT(spool_->MarkClean(), IsOk());
  std::ofstream(options_.dir + "/notes.txt") << "mine";
  std::ofstream(options_.dir + "/zz-not-a-segment.seg") << "mine";
  EXPECT_THAT(Texts(Reopen()), ElementsAre("m1+1 one"));
  EXPECT_TRUE(fs::exists(options_.dir + "/notes.txt"));
  EXPECT_TRUE(fs::exists(options_.dir + "/zz-not-a-segment.seg"));
}

// Two segments of one stream and one of another, closed in order.
class DamagedSpoolTest : public SpoolTest {
 protected:
  void SetUp() override {
    options_.segment_bytes = 150;
    Open();
    for (uint64_t i = 0; i < 4; ++i) Append(kMessages, 1 + 2 * i, 2, std::string(20, 'm'));
    Append(kControl, 1, 1, "c");
    Append(kControl, 2, 1, "d");
    ASSERT_THAT(spool_->MarkClean(), IsOk());
    spool_.reset();
    ASSERT_THAT(Segments(), SizeIs(3));
    for (const fs::path& each : Segments()) {
      files_.emplace_back(each, *ReadFile(each, 1 << 20));
    }
  }
  void Restore() {
    spool_.reset();
    for (const auto& [path, bytes] : files_) std::ofstream(path, std::ios::binary) << bytes;
  }
  // Ten observations: what is read, and what is told as lost, is all of them, unless something
  // unknown is told as lost.
  void ExpectAccounted(const Recovered& recovered, const std::string& what) {
    uint64_t read = 0;
    for (const SpoolRecord& each : recovered.records) {
      EXPECT_THAT(spool_->Read(each), IsOk()) << what;
      read += each.count;
    }
    uint64_t lost = 0;
    for (const SpoolGap& each : recovered.gaps) lost += each.count;
    EXPECT_LE(read + lost, 10u) << what;
    if (!recovered.unknown_lost) {
      EXPECT_EQ(read + lost, 10u) << what;
    }
    std::map<StreamKey, uint64_t> next;
    for (const SpoolRecord& each : recovered.records) {
      EXPECT_GE(each.first_sequence, next[each.stream]) << what;
      next[each.stream] = each.first_sequence + each.count;
    }
  }

  std::vector<std::pair<fs::path, std::string>> files_;
};

TEST_F(DamagedSpoolTest, EveryFlippedByteIsAccountedAndCostsOneFrameAtMost) {
  for (const auto& [path, bytes] : files_) {
    for (size_t i = 0; i < bytes.size(); ++i) {
      Restore();
      std::string damaged = bytes;
      damaged[i] = static_cast<char>(damaged[i] ^ 0x20);
      std::ofstream(path, std::ios::binary) << damaged;
      const std::string what = absl::StrCat(path.filename().string(), " byte ", i);

      const Recovered recovered = Open();

      ExpectAccounted(recovered, what);
      EXPECT_THAT(recovered.problems, Not(IsEmpty())) << what;
      EXPECT_GE(recovered.records.size(), 5u) << what;
      ASSERT_THAT(spool_->MarkClean(), IsOk());
    }
  }
}

TEST_F(DamagedSpoolTest, CutAtEveryLengthIsAccounted) {
  for (const auto& [path, bytes] : files_) {
    for (size_t length = 0; length < bytes.size(); ++length) {
      Restore();
      std::ofstream(path, std::ios::binary) << bytes.substr(0, length);
      const std::string what = absl::StrCat(path.filename().string(), " cut at ", length);

      const Recovered recovered = Open();

      ExpectAccounted(recovered, what);
      EXPECT_TRUE(recovered.unknown_lost || !recovered.gaps.empty() ||
                  recovered.records.size() == 6)
          << what;
      EXPECT_THAT(recovered.problems, Not(IsEmpty())) << what;
      ASSERT_THAT(spool_->MarkClean(), IsOk());
    }
  }
}

TEST_F(DamagedSpoolTest, AMissingSegmentIsAGapOfKnownLength) {
  fs::remove(files_[0].first);
  // The stream begins with its second segment then: what is before it is the server's to know.
  EXPECT_THAT(Open().gaps, IsEmpty());
  spool_.reset();
  Restore();
  fs::resize_file(files_[0].first, 0);

  const Recovered recovered = Open();

  ASSERT_THAT(recovered.gaps, SizeIs(1));
  EXPECT_EQ(recovered.gaps[0],
            (SpoolGap{.stream = kMessages, .first_sequence = 1, .count = 4, .at_end = false}));
}

TEST_F(DamagedSpoolTest, WhatIsDamagedAfterRecoveryIsDataLoss) {
  const Recovered recovered = Open();
  for (const auto& [path, bytes] : files_) fs::resize_file(path, kSegmentHeaderBytes + 3);
  for (const SpoolRecord& each : recovered.records) {
    EXPECT_TRUE(absl::IsDataLoss(spool_->Read(each).status()));
  }
  for (const SpoolRecord& each : recovered.records) spool_->Release(each);
  EXPECT_THAT(Segments(), IsEmpty());
}

}  // namespace
}  // namespace rips::sensor
