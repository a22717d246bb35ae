#include "services/ros2/cdr.h"

#include <limits>
#include <utility>

#include "absl/strings/escaping.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::ros2 {
namespace {

using ::testing::HasSubstr;

std::string Sample(ByteOrder order) {
  CdrWriter writer(order);
  writer.U8(7);
  writer.U16(0x1234);
  writer.U8(9);
  writer.U32(0x89abcdef);
  writer.Bool(true);
  writer.I64(-2);
  writer.String("hi");
  writer.F64(0.5);
  writer.String("");
  writer.Octets("abc");
  return std::move(writer).Finish();
}

void ExpectSample(CdrReader& reader) {
  EXPECT_EQ(reader.U8(), 7);
  EXPECT_EQ(reader.U16(), 0x1234);
  EXPECT_EQ(reader.U8(), 9);
  EXPECT_EQ(reader.U32(), 0x89abcdef);
  EXPECT_TRUE(reader.Bool());
  EXPECT_EQ(reader.I64(), -2);
  EXPECT_EQ(reader.String(), "hi");
  EXPECT_EQ(reader.F64(), 0.5);
  EXPECT_EQ(reader.String(), "");
  EXPECT_EQ(reader.Octets(3), "abc");
}

TEST(CdrTest, RoundTripInBothOrders) {
  for (ByteOrder order : {ByteOrder::kLittle, ByteOrder::kBig}) {
    const std::string payload = Sample(order);
    EXPECT_EQ(payload.size() % 4, 0u);
    CdrReader reader(payload);
    ExpectSample(reader);
    EXPECT_THAT(reader.Finish(), IsOk());
  }
}

TEST(CdrTest, BytesOnTheWire) {
  CdrWriter little;
  little.U8(1);
  little.U32(2);
  EXPECT_EQ(absl::BytesToHexString(std::move(little).Finish()), "000100000100000002000000");
  CdrWriter big(ByteOrder::kBig);
  big.U8(1);
  big.U64(2);
  EXPECT_EQ(absl::BytesToHexString(std::move(big).Finish()),
            "0000000001000000000000000000000000000002");
}

TEST(CdrTest, TruncationAtEveryByteFails) {
  const std::string payload = Sample(ByteOrder::kLittle);
  const size_t needed = payload.size() - 1;  // one byte of padding at the end
  for (size_t size = 0; size < needed; ++size) {
    // A copy on the heap, so that a read past the end is seen by the sanitizer.
    const std::string cut = payload.substr(0, size);
    CdrReader reader(cut);
    reader.U8();
    reader.U16();
    reader.U8();
    reader.U32();
    reader.Bool();
    reader.I64();
    reader.String();
    reader.F64();
    reader.String();
    reader.Octets(3);
    EXPECT_THAT(reader.Finish(), StatusIs(absl::StatusCode::kDataLoss)) << size;
  }
}

TEST(CdrTest, OnlyPlainCdrIsRead) {
  for (const char* header : {"\x00\x02", "\x00\x03", "\x00\x06", "\x00\x07", "\x01\x01"}) {
    const std::string payload = std::string(header, 2) + std::string(6, '\0');
    CdrReader reader(payload);
    EXPECT_EQ(reader.U32(), 0u);
    EXPECT_THAT(reader.Finish(),
                StatusIs(absl::StatusCode::kDataLoss, HasSubstr("is not plain CDR")));
  }
}

TEST(CdrTest, UpToThreeBytesMayFollow) {
  for (size_t extra = 0; extra <= 5; ++extra) {
    const std::string payload = std::string("\0\1\0\0\0\0\0\0", 8) + std::string(extra, 'x');
    CdrReader reader(payload);
    reader.U32();
    EXPECT_EQ(reader.Finish().ok(), extra <= kCdrPaddingBytesMax) << extra;
  }
}

std::string StringPayload(uint32_t length, absl::string_view bytes) {
  CdrWriter writer;
  writer.U32(length);
  writer.Octets(bytes);
  return std::move(writer).Finish();
}

TEST(CdrTest, HostileStrings) {
  const std::pair<uint32_t, std::string> cases[] = {
      {0xffffffff, "abc"},               // longer than the payload
      {9, "abc"},                        // likewise, by little
      {3, "abc"},                        // no terminator
      {4, std::string("a\0b\0", 4)},     // NUL within
      {4, std::string("ab\0\0", 4)},     // two terminators
      {1u << 30, std::string(16, 'a')},  // past the limit
      {std::numeric_limits<uint32_t>::max() - 3, "abcd"},
  };
  for (const auto& [length, bytes] : cases) {
    const std::string payload = StringPayload(length, bytes);
    CdrReader reader(payload);
    EXPECT_EQ(reader.String(), "");
    EXPECT_THAT(reader.status(), StatusIs(absl::StatusCode::kDataLoss)) << length;
  }
  const std::string empty = StringPayload(0, "");
  CdrReader reader(empty);
  EXPECT_EQ(reader.String(), "");
  EXPECT_THAT(reader.Finish(), IsOk());
}

TEST(CdrTest, StringLimitIsInclusive) {
  const std::string payload = StringPayload(6, std::string("abcde\0", 6));
  CdrReader fits(payload, {.string_bytes = 5});
  EXPECT_EQ(fits.String(), "abcde");
  CdrReader exceeds(payload, {.string_bytes = 4});
  exceeds.String();
  EXPECT_THAT(exceeds.status(),
              StatusIs(absl::StatusCode::kDataLoss, "string of 5 bytes exceeds limit 4"));
}

TEST(CdrTest, HostileCounts) {
  const std::string payload = StringPayload(3, std::string(8, '\0'));
  EXPECT_EQ(CdrReader(payload).Count(1, 3), 3u);
  EXPECT_EQ(CdrReader(payload).Count(2, 3), 3u);
  CdrReader too_many(payload);
  EXPECT_EQ(too_many.Count(1, 2), 0u);
  EXPECT_THAT(too_many.status(), StatusIs(absl::StatusCode::kDataLoss, HasSubstr("limit 2")));
  CdrReader cannot_fit(payload);
  EXPECT_EQ(cannot_fit.Count(3, 3), 0u);
  EXPECT_FALSE(cannot_fit.ok());
  const std::string huge = StringPayload(0xffffffff, "");
  CdrReader wraps(huge);
  EXPECT_EQ(wraps.Count(16, SIZE_MAX), 0u);
  EXPECT_FALSE(wraps.ok());
}

TEST(CdrTest, BoolHoldsZeroOrOne) {
  CdrWriter writer;
  writer.U8(2);
  const std::string payload = std::move(writer).Finish();
  CdrReader reader(payload);
  EXPECT_FALSE(reader.Bool());
  EXPECT_THAT(reader.status(), StatusIs(absl::StatusCode::kDataLoss, "a bool holds 2"));
}

TEST(CdrTest, TheFirstFailureStays) {
  CdrReader reader("");
  reader.Fail("second");
  EXPECT_THAT(reader.status(),
              StatusIs(absl::StatusCode::kDataLoss, HasSubstr("no encapsulation header")));
}

}  // namespace
}  // namespace rips::ros2
