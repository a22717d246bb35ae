#include "sensor_agent/wire/content_table.h"

#include <string>

#include "gtest/gtest.h"
#include "sensor_agent/wire/rtps_bytes.h"

namespace rips::wire {
namespace {

constexpr int64_t kNowNs = 100 * kNanosPerSecond;
const ros2::Guid kWriter = TestGuid(1, 0x00000103);

RtpsSubmessage Data(uint64_t sequence, absl::string_view content) {
  return {.writer = kWriter,
          .sequence = sequence,
          .content = content,
          .content_size = static_cast<uint32_t>(content.size())};
}

class ContentTableTest : public testing::Test {
 protected:
  bool Differs(const RtpsSubmessage& data) { return table_.Differs(data, now_ns_); }

  int64_t now_ns_ = kNowNs;
  ContentTable table_{SipKey{.low = 1, .high = 2}};
};

TEST_F(ContentTableTest, RetransmissionsHaveTheSameContent) {
  for (int i = 0; i < 3; ++i) EXPECT_FALSE(Differs(Data(1, "forward")));
  EXPECT_FALSE(Differs(Data(2, "backward")));
}

TEST_F(ContentTableTest, OneNumberWithTwoContentsDiffers) {
  EXPECT_FALSE(Differs(Data(1, "forward")));
  EXPECT_TRUE(Differs(Data(1, "forwarD")));
  EXPECT_TRUE(Differs(Data(1, "forward!")));
  EXPECT_TRUE(Differs(Data(1, "")));  // disposes instead of writing
  EXPECT_FALSE(Differs(Data(1, "forward")));
}

TEST_F(ContentTableTest, WritersAndFragmentsAreApart) {
  EXPECT_FALSE(Differs(Data(1, "forward")));
  RtpsSubmessage other = Data(1, "left");
  other.writer = TestGuid(2, 0x00000103);
  EXPECT_FALSE(Differs(other));
  RtpsSubmessage fragment = Data(1, "first");
  fragment.fragment = 1;
  EXPECT_FALSE(Differs(fragment));
  fragment.content = "other";
  EXPECT_TRUE(Differs(fragment));
}

TEST_F(ContentTableTest, ALongContentIsComparedAsFarAsItIsAlwaysAtHand) {
  const std::string payload(3'000, 'p');
  std::string other = payload;
  other[ContentTable::kBytesCompared - 1] = 'q';
  RtpsSubmessage whole = Data(1, payload);
  EXPECT_FALSE(Differs(whole));

  // With more headers before it less is captured.
  RtpsSubmessage part = Data(1, absl::string_view(payload).substr(0, 1'450));
  part.content_size = 3'000;
  EXPECT_FALSE(Differs(part));
  part.content = absl::string_view(other).substr(0, 1'450);
  EXPECT_TRUE(Differs(part));
  part.content = absl::string_view(other).substr(0, ContentTable::kBytesCompared - 1);
  EXPECT_FALSE(Differs(part));
  // The size is known all the same.
  part = Data(1, absl::string_view(payload).substr(0, 1'450));
  part.content_size = 3'001;
  EXPECT_TRUE(Differs(part));
}

TEST_F(ContentTableTest, WhatIsNotKnownIsNotCompared) {
  RtpsSubmessage unknown = Data(1, "");
  unknown.content_unknown = true;
  EXPECT_FALSE(Differs(unknown));
  EXPECT_FALSE(Differs(Data(1, "forward")));
  EXPECT_FALSE(Differs(unknown));
}

TEST_F(ContentTableTest, AWriterUnderAFormerNameMayCountFromOne) {
  EXPECT_FALSE(Differs(Data(1, "before")));
  now_ns_ += ContentTable::kKeptNs;

  EXPECT_FALSE(Differs(Data(1, "after")));
  EXPECT_TRUE(Differs(Data(1, "before")));
}

TEST_F(ContentTableTest, HoldsASecondOfABusyBusAndForgetsTheOldest) {
  constexpr uint64_t kBusy = 10'000;
  for (uint64_t i = 1; i <= kBusy; ++i) EXPECT_FALSE(Differs(Data(i, "forward")));
  size_t held = 0;
  for (uint64_t i = 1; i <= kBusy; ++i) held += Differs(Data(i, "backward")) ? 1 : 0;
  EXPECT_GE(held, kBusy - kBusy / 100);

  // However many there are, the newest are there.
  for (uint64_t i = 1; i <= 500'000; ++i) {
    ++now_ns_;
    Differs(Data(i + kBusy, "forward"));
  }
  EXPECT_TRUE(Differs(Data(500'000 + kBusy, "backward")));
  EXPECT_FALSE(Differs(Data(1, "backward")));
}

TEST(SipHashTest, IsTheFunctionThatIsPublished) {
  // Key 00 01 .. 0f and messages 00 01 .. of SipHash-1-3.
  const SipKey key = {.low = 0x0706050403020100, .high = 0x0f0e0d0c0b0a0908};
  EXPECT_EQ(SipHash(key, ""), 0xabac0158050fc4dc);
  std::string message;
  for (char c = 0; c < 15; ++c) message += c;
  EXPECT_EQ(SipHash(key, message), 0xd320d86d2a519956);
  EXPECT_NE(SipHash({.low = 1}, message), SipHash({.low = 2}, message));
}

}  // namespace
}  // namespace rips::wire
