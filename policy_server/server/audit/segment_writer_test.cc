#include "policy_server/server/audit/segment_writer.h"

#include <signal.h>
#include <sys/resource.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <iterator>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/audit/segments.h"
#include "services/base/status_matchers.h"

namespace rips::audit {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr uint64_t kLarge = 1 << 20;

std::string Content(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
}

void Put(const fs::path& path, absl::string_view bytes) {
  std::ofstream(path, std::ios::binary | std::ios::trunc) << bytes;
}

class SegmentWriterTest : public testing::Test {
 protected:
  SegmentWriterTest() {
    std::string name = (fs::temp_directory_path() / "audit-XXXXXX").string();
    EXPECT_NE(mkdtemp(name.data()), nullptr);
    root_ = name;
    directory_ = name + "/audit";
  }
  ~SegmentWriterTest() override { fs::remove_all(root_); }

  std::unique_ptr<SegmentWriter> Open(uint64_t segment_bytes = kLarge) {
    auto writer = SegmentWriter::Open(directory_, segment_bytes, 1);
    EXPECT_TRUE(writer.ok()) << writer.status();
    return writer.ok() ? *std::move(writer) : nullptr;
  }
  absl::Status Append(SegmentWriter& writer, int records = 1) {
    return writer.Append(std::vector<std::string>(records, "what"), 1);
  }
  Report Verified(std::vector<Head> heads = {}) {
    const absl::StatusOr<Report> report = Verify(SegmentsInDirectory(directory_), heads);
    EXPECT_TRUE(report.ok()) << report.status();
    return report.ok() ? *report : Report();
  }
  void ExpectWhole(uint64_t records, std::vector<Head> heads = {}) {
    const Report report = Verified(std::move(heads));
    EXPECT_FALSE(report.fault.has_value()) << report.fault->text;
    EXPECT_EQ(report.records, records);
  }
  fs::path Segment(uint64_t number) const { return fs::path(directory_) / SegmentName(number); }

  fs::path root_;
  std::string directory_;
};

TEST_F(SegmentWriterTest, WhatIsWrittenIsWholeAndGoesOnAfterAStart) {
  Head head;
  for (int start = 0; start < 3; ++start) {
    const auto writer = Open();
    ASSERT_TRUE(Append(*writer, 2).ok());
    head = writer->head();
    EXPECT_EQ(writer->segment(), 1u);
  }
  ExpectWhole(6, {head});
  struct stat key = {};
  ASSERT_EQ(stat((directory_ + "/key").c_str(), &key), 0);
  EXPECT_EQ(key.st_mode & 0777, 0600u);
}

TEST_F(SegmentWriterTest, EachSegmentHasAKeyOfItsOwnAndTheOldOneIsGone) {
  const auto writer = Open(/*segment_bytes=*/1);
  std::string keys;
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(Append(*writer).ok());
    const std::string key = Content(directory_ + "/key");
    EXPECT_THAT(keys, testing::Not(HasSubstr(key)));
    keys += key;
  }
  EXPECT_FALSE(fs::exists(directory_ + "/key.next"));
  EXPECT_EQ(writer->segment(), 4u);
  ExpectWhole(4);
}

TEST_F(SegmentWriterTest, AfterACrashAtEachByteOfAWriteTheLogGoesOn) {
  Head sealed;
  {
    const auto writer = Open();
    ASSERT_TRUE(Append(*writer, 2).ok());
    sealed = writer->head();
  }
  const std::string before = Content(Segment(1));
  const std::string key = Content(directory_ + "/key");
  ASSERT_TRUE(Append(*Open(), 2).ok());
  const std::string after = Content(Segment(1));
  for (size_t cut = before.size(); cut < after.size(); ++cut) {
    fs::remove_all(directory_);
    fs::create_directory(directory_);
    Put(Segment(1), after.substr(0, cut));
    Put(directory_ + "/key", key);
    const auto writer = Open();
    ASSERT_NE(writer, nullptr) << cut;
    ASSERT_TRUE(Append(*writer).ok());
    ExpectWhole(3, {sealed, writer->head()});
    EXPECT_EQ(Verified().torn.size(), cut > before.size() ? 1u : 0u) << cut;
  }
}

TEST_F(SegmentWriterTest, ACrashBetweenSegmentAndKeyLosesNeither) {
  ASSERT_TRUE(Append(*Open(/*segment_bytes=*/1)).ok());
  const std::string old_key = Content(directory_ + "/key");
  ASSERT_TRUE(Append(*Open(1)).ok());  // segment 2
  const std::string new_key = Content(directory_ + "/key");

  // Its header was written, its key not yet renamed.
  Put(directory_ + "/key.next", new_key);
  Put(directory_ + "/key", old_key);
  ASSERT_TRUE(Append(*Open(1)).ok());
  ExpectWhole(3);
  // The old key was overwritten, then the power went.
  Put(directory_ + "/key.next", Content(directory_ + "/key"));
  Put(directory_ + "/key", std::string(64, '0'));
  ASSERT_TRUE(Append(*Open(1)).ok());
  ExpectWhole(4);
  // The next key was written, its segment was not.
  Put(directory_ + "/key.next", old_key);
  ASSERT_TRUE(Append(*Open(1)).ok());
  ExpectWhole(5);
}

TEST_F(SegmentWriterTest, ALogThatWasAlteredIsNotContinued) {
  ASSERT_TRUE(Append(*Open(), 2).ok());
  ASSERT_TRUE(Append(*Open(), 2).ok());
  const std::string good = Content(Segment(1));
  for (const size_t at : {size_t{20}, size_t{kHeaderBytes + 60}, good.size() - 40}) {
    std::string bad = good;
    bad[at] = static_cast<char>(bad[at] ^ 1);
    Put(Segment(1), bad);
    const auto writer = SegmentWriter::Open(directory_, kLarge, 1);
    // Of the last seal alone nothing tells whether a crash or a hand did it: it is left as torn,
    // and the head that a robot or an auditor has tells the rest.
    if (at == good.size() - 40) {
      EXPECT_TRUE(writer.ok()) << writer.status();
    } else {
      EXPECT_EQ(writer.status().code(), absl::StatusCode::kDataLoss) << at;
      EXPECT_THAT(std::string(writer.status().message()), HasSubstr("ripsctl audit verify"));
    }
  }
}

TEST_F(SegmentWriterTest, WithoutItsKeyALogIsNotContinued) {
  ASSERT_TRUE(Append(*Open()).ok());
  const std::string key = Content(directory_ + "/key");
  for (const std::string& wrong : {std::string(), std::string("zz"), std::string(64, '1')}) {
    Put(directory_ + "/key", wrong);
    EXPECT_EQ(SegmentWriter::Open(directory_, kLarge, 1).status().code(),
              absl::StatusCode::kDataLoss);
  }
  Put(directory_ + "/key", key);
  fs::remove(Segment(1));
  EXPECT_EQ(SegmentWriter::Open(directory_, kLarge, 1).status().code(),
            absl::StatusCode::kDataLoss);
}

TEST_F(SegmentWriterTest, OneProcessWritesALog) {
  const auto writer = Open();
  EXPECT_EQ(SegmentWriter::Open(directory_, kLarge, 1).status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST_F(SegmentWriterTest, AWriteThatFailsLeavesNothingOfItself) {
  const auto writer = Open();
  ASSERT_TRUE(Append(*writer, 2).ok());
  // The file may not grow: as on a full disk, but for the error's name.
  const rlim_t size = fs::file_size(Segment(1)) + 10;
  struct rlimit old = {};
  ASSERT_EQ(getrlimit(RLIMIT_FSIZE, &old), 0);
  signal(SIGXFSZ, SIG_IGN);
  struct rlimit small = {size, old.rlim_max};
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &small), 0);
  EXPECT_FALSE(Append(*writer, 3).ok());
  EXPECT_FALSE(Append(*writer, 3).ok());
  ASSERT_EQ(setrlimit(RLIMIT_FSIZE, &old), 0);
  EXPECT_EQ(writer->head().sequence, 2u);
  ASSERT_TRUE(Append(*writer).ok());
  ExpectWhole(3);
  EXPECT_THAT(Verified().torn, IsEmpty());
}

}  // namespace
}  // namespace rips::audit
