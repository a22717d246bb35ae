// Where ParseRtps finds the content of samples, and the numbers of HEARTBEAT and GAP.
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/wire/rtps_bytes.h"
#include "sensor_agent/wire/rtps_parser.h"

namespace rips::wire {
namespace {

using ::testing::IsEmpty;
using ::testing::SizeIs;
using Kind = RtpsSubmessage::Kind;

const ros2::Guid kSender = TestGuid(1, 0);
const ros2::Guid kWriter = TestGuid(1, 0x00000103);

// The contents are views into `bytes`.
RtpsDatagram ParsePart(absl::string_view bytes, size_t size) {
  RtpsDatagram datagram;
  EXPECT_TRUE(ParseRtps(bytes, size, datagram));
  return datagram;
}
RtpsSubmessage ParseOne(const std::string& bytes) {
  const RtpsDatagram datagram = ParsePart(bytes, bytes.size());
  EXPECT_FALSE(datagram.malformed);
  EXPECT_THAT(datagram.submessages, SizeIs(1));
  return datagram.submessages.empty() ? RtpsSubmessage{} : datagram.submessages[0];
}

TEST(RtpsContentTest, IsTheSerializedPayload) {
  for (const ByteOrder order : {ByteOrder::kLittle, ByteOrder::kBig}) {
    RtpsBytes plain(kSender, order);
    plain.Sample(kWriter, 1, "payload");
    const RtpsSubmessage without = ParseOne(plain.bytes());
    EXPECT_EQ(without.content, "payload");
    EXPECT_EQ(without.content_size, 7);
    EXPECT_EQ(without.fragment, 0);

    RtpsBytes with(kSender, order);
    with.Sample(kWriter, 1, "payload",
                with.Parameter(0x70, "hash of the key.") + with.Parameter(1, ""));
    EXPECT_EQ(ParseOne(with.bytes()).content, "payload");
  }
}

TEST(RtpsContentTest, AKeyIsNone) {
  std::string bytes = RtpsBytes(kSender).Sample(kWriter, 1, "the key").bytes();
  bytes[kRtpsHeaderBytes + 1] = 0x09;  // key flag, little-endian

  const RtpsSubmessage data = ParseOne(bytes);

  EXPECT_EQ(data.content_size, 0);
  EXPECT_FALSE(data.content_unknown);
}

TEST(RtpsContentTest, AFragmentIsAsLongAsItSaysAtMost) {
  // Two of them in one submessage: the first counts.
  std::string two = "first___second__";
  const std::string bytes = RtpsBytes(kSender).DataFrag(kWriter, 1, 0, two, 4, 8).bytes();

  const RtpsSubmessage data = ParseOne(bytes);

  EXPECT_EQ(data.kind, Kind::kDataFrag);
  EXPECT_EQ(data.content, "first___");
  EXPECT_EQ(data.content_size, 8);
  EXPECT_EQ(data.fragment, 4);
}

TEST(RtpsContentTest, QosThatDoesNotEndHidesIt) {
  const RtpsBytes parts(kSender);
  const std::string endless[] = {
      // No sentinel, a length past the end, and half a header.
      parts.Parameter(0x70, "hash of the key."),
      std::string("\x70\x00\xff\xff", 4),
      std::string("\x70\x00", 2),
  };
  for (const std::string& qos : endless) {
    const RtpsSubmessage data = ParseOne(RtpsBytes(kSender).Sample(kWriter, 1, "", qos).bytes());
    EXPECT_TRUE(data.content_unknown);
    EXPECT_THAT(data.content, IsEmpty());
    EXPECT_EQ(data.sequence, 1);
  }
  std::string far = RtpsBytes(kSender).Sample(kWriter, 1, "payload").bytes();
  far[kRtpsHeaderBytes + 4 + 2] = '\xff';  // the payload would begin past the end
  EXPECT_TRUE(ParseOne(far).content_unknown);
}

TEST(RtpsContentTest, ManyParametersArePassedOver) {
  RtpsBytes bytes(kSender);
  std::string qos;
  for (int i = 0; i < 10'000; ++i) qos += bytes.Parameter(0x70, "");
  bytes.Sample(kWriter, 1, "payload", qos + bytes.Parameter(1, ""));

  EXPECT_EQ(ParseOne(bytes.bytes()).content, "payload");
}

TEST(RtpsContentTest, IsCutWithWhatIsAtHand) {
  const std::string whole = RtpsBytes(kSender).Sample(kWriter, 1, std::string(3'000, 'p')).bytes();

  const RtpsDatagram datagram = ParsePart(absl::string_view(whole).substr(0, 1'600), whole.size());

  ASSERT_THAT(datagram.submessages, SizeIs(1));
  EXPECT_EQ(datagram.submessages[0].content_size, 3'000);
  EXPECT_THAT(datagram.submessages[0].content, SizeIs(1'600 - kRtpsHeaderBytes - 24));
}

TEST(RtpsContentTest, HeartbeatAndGapSayWhatWillNotCome) {
  const RtpsSubmessage heartbeat = ParseOne(RtpsBytes(kSender).Heartbeat(kWriter, 7, 9).bytes());
  EXPECT_EQ(heartbeat.sequence, 9);
  EXPECT_EQ(heartbeat.dropped, 6);
  // Nothing yet, and a first number that no writer has.
  EXPECT_EQ(ParseOne(RtpsBytes(kSender).Heartbeat(kWriter, 1, 0).bytes()).dropped, 0);
  EXPECT_EQ(ParseOne(RtpsBytes(kSender).Heartbeat(kWriter, -5, 9).bytes()).dropped, 0);

  const RtpsSubmessage gap = ParseOne(RtpsBytes(kSender).Gap(kWriter, 3, 1LL << 40, 32).bytes());
  EXPECT_EQ(gap.kind, Kind::kGap);
  EXPECT_EQ(gap.writer, kWriter);
  EXPECT_EQ(gap.dropped, (uint64_t{1} << 40) - 1);
}

TEST(RtpsContentTest, AGapThatMakesNoSenseIsPassedOver) {
  RtpsBytes bytes(kSender);
  bytes.Gap(kWriter, 0, 5).Gap(kWriter, 1, -5).Submessage(0x08, "short").Data(kWriter, 3);

  const RtpsSubmessage data = ParseOne(bytes.bytes());

  EXPECT_EQ(data.kind, Kind::kData);
  EXPECT_EQ(data.sequence, 3);
}

}  // namespace
}  // namespace rips::wire
