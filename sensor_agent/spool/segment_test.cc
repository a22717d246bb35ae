#include "sensor_agent/spool/segment.h"

#include <set>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

const SegmentHeader kHeader{.stream = {.incarnation = std::string(16, 'i'), .lane = Lane::kControl},
                            .index = 7,
                            .first_sequence = 5,
                            .boot_id = std::string(16, 'b'),
                            .unix_minus_boottime_ns = -3};

std::string Segment(const std::vector<Frame>& frames, const SegmentHeader& header = kHeader) {
  std::string file = EncodeSegmentHeader(header);
  for (const Frame& each : frames) AppendFrame(FrameSeed(header), each, &file);
  return file;
}

// Their first sequences.
std::vector<uint64_t> Read(absl::string_view file, size_t* skipped = nullptr) {
  FrameScanner scanner(FrameSeed(kHeader), file);
  std::vector<uint64_t> read;
  while (const auto frame = scanner.Next()) read.push_back(frame->first_sequence);
  if (skipped != nullptr) *skipped = scanner.skipped();
  return read;
}

const std::vector<Frame> kThree = {
    {.first_sequence = 5, .count = 2, .oldest_ns = 11, .payload = "one"},
    {.first_sequence = 7, .count = 1, .oldest_ns = 12, .payload = ""},
    {.first_sequence = 8, .count = 3, .oldest_ns = -1, .payload = "three"}};

TEST(Crc32cTest, HasItsCheckValues) {
  EXPECT_EQ(Crc32c(0, "123456789"), 0xE3069283u);
  EXPECT_EQ(Crc32c(0, std::string(32, '\0')), 0x8A9136AAu);  // RFC 3720 §B.4
  EXPECT_EQ(Crc32c(Crc32c(0, "12345"), "6789"), 0xE3069283u);
  EXPECT_EQ(Crc32c(0, ""), 0u);
}

TEST(SegmentTest, HeaderAndNameRoundTrip) {
  const std::string bytes = EncodeSegmentHeader(kHeader);
  ASSERT_THAT(bytes, SizeIs(kSegmentHeaderBytes));
  const auto header = DecodeSegmentHeader(bytes);
  ASSERT_THAT(header, IsOk());
  EXPECT_EQ(*header, kHeader);
  const auto named = ParseSegmentName(SegmentName(kHeader));
  ASSERT_TRUE(named.has_value());
  EXPECT_EQ(named->stream, kHeader.stream);
  EXPECT_EQ(named->index, kHeader.index);
  EXPECT_EQ(named->first_sequence, kHeader.first_sequence);
}

TEST(SegmentTest, OtherNamesAreNone) {
  const std::string name = SegmentName(kHeader);
  EXPECT_FALSE(ParseSegmentName("").has_value());
  EXPECT_FALSE(ParseSegmentName("lock").has_value());
  EXPECT_FALSE(ParseSegmentName(name + "~").has_value());
  EXPECT_FALSE(ParseSegmentName(name.substr(1)).has_value());
  for (size_t i = 0; i < name.size(); ++i) {
    std::string other = name;
    other[i] = 'x';
    EXPECT_FALSE(ParseSegmentName(other).has_value()) << other;
  }
}

TEST(SegmentTest, HeaderDamagedAnywhereIsDataLoss) {
  const std::string bytes = EncodeSegmentHeader(kHeader);
  for (size_t i = 0; i < bytes.size(); ++i) {
    std::string damaged = bytes;
    damaged[i] = static_cast<char>(damaged[i] ^ 0x10);
    EXPECT_TRUE(absl::IsDataLoss(DecodeSegmentHeader(damaged).status())) << i;
    EXPECT_TRUE(absl::IsDataLoss(DecodeSegmentHeader(bytes.substr(0, i)).status())) << i;
  }
}

TEST(SegmentTest, FramesRoundTrip) {
  const std::string empty = Segment({});
  FrameScanner scanner(FrameSeed(kHeader), empty);
  EXPECT_FALSE(scanner.Next().has_value());
  const std::string file = Segment(kThree);
  FrameScanner three(FrameSeed(kHeader), file);
  for (const Frame& expected : kThree) {
    const auto frame = three.Next();
    ASSERT_TRUE(frame.has_value());
    EXPECT_EQ(frame->first_sequence, expected.first_sequence);
    EXPECT_EQ(frame->count, expected.count);
    EXPECT_EQ(frame->oldest_ns, expected.oldest_ns);
    EXPECT_EQ(frame->payload, expected.payload);
    const auto again =
        DecodeFrame(FrameSeed(kHeader), absl::string_view(file).substr(frame->offset));
    ASSERT_THAT(again, IsOk());
    EXPECT_EQ(again->payload, expected.payload);
  }
  EXPECT_FALSE(three.Next().has_value());
  EXPECT_EQ(three.skipped(), 0u);
}

TEST(SegmentTest, AFlippedByteCostsItsFrameAndNoOther) {
  const std::string file = Segment(kThree);
  for (size_t i = kSegmentHeaderBytes; i < file.size(); ++i) {
    std::string damaged = file;
    damaged[i] = static_cast<char>(damaged[i] ^ 0x01);
    size_t skipped = 0;
    const std::vector<uint64_t> read = Read(damaged, &skipped);
    EXPECT_THAT(read, SizeIs(2)) << i;
    EXPECT_GT(skipped, 0u) << i;
    EXPECT_EQ(std::set<uint64_t>(read.begin(), read.end()).size(), 2u) << i;
  }
}

TEST(SegmentTest, CutAnywhereTheFramesBeforeAreRead) {
  const std::string file = Segment(kThree);
  for (size_t length = 0; length < file.size(); ++length) {
    const std::vector<uint64_t> read = Read(file.substr(0, length));
    size_t expected = 0;
    size_t end = kSegmentHeaderBytes;
    for (const Frame& each : kThree) {
      end += kFrameHeaderBytes + each.payload.size();
      if (length >= end) ++expected;
    }
    EXPECT_THAT(read, SizeIs(expected)) << length;
  }
}

TEST(SegmentTest, RobotsBytesThatLookLikeAFrameAreNone) {
  SegmentHeader other = kHeader;
  other.stream.incarnation = std::string(16, 'o');  // whoever writes payloads does not know ours
  std::string forged;
  AppendFrame(FrameSeed(other), {.first_sequence = 9, .count = 1, .payload = "forged"}, &forged);
  std::string file = Segment({{.first_sequence = 5, .count = 1, .payload = forged},
                              {.first_sequence = 6, .count = 1, .payload = "good"}});
  EXPECT_THAT(Read(file), ElementsAre(5, 6));
  file[kSegmentHeaderBytes] = 'x';  // so that the payload is looked through
  EXPECT_THAT(Read(file), ElementsAre(6));
}

TEST(SegmentTest, FramesOfAnotherSegmentAreNone) {
  SegmentHeader other = kHeader;
  ++other.index;
  EXPECT_THAT(Read(Segment(kThree, other)), IsEmpty());
}

}  // namespace
}  // namespace rips::sensor
