#include "sensor_agent/wire/rtps_parser.h"

#include <fstream>
#include <iterator>
#include <set>
#include <sstream>
#include <string>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/wire/packet_filter.h"
#include "sensor_agent/wire/rtps_bytes.h"

namespace rips::wire {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using Kind = RtpsSubmessage::Kind;

const ros2::Guid kSender = TestGuid(1, 0);
const ros2::Guid kWriter = TestGuid(1, 0x00000103);
constexpr uint32_t kReader = 0x00000204;

// Of a datagram that is at hand whole.
RtpsDatagram Parse(const std::string& bytes) {
  RtpsDatagram datagram;
  EXPECT_TRUE(ParseRtps(bytes, bytes.size(), datagram));
  return datagram;
}

TEST(RtpsParserTest, ReadsWriterReaderAndSequenceInBothByteOrders) {
  for (const ByteOrder order : {ByteOrder::kLittle, ByteOrder::kBig}) {
    const std::string bytes = RtpsBytes(kSender, order)
                                  .InfoTimestamp()
                                  .Data(kWriter, 7)
                                  .DataFrag(kWriter, 0x1'0000'0002, kReader)
                                  .Heartbeat(kWriter, 1, 9)
                                  .bytes();
    const RtpsDatagram datagram = Parse(bytes);

    EXPECT_EQ(datagram.sender, kSender);
    EXPECT_EQ(datagram.vendor, 0x0110);
    EXPECT_FALSE(datagram.malformed || datagram.cut || datagram.secured);
    EXPECT_THAT(datagram.submessages,
                ElementsAre(RtpsSubmessage{Kind::kData, kWriter, false, 7},
                            RtpsSubmessage{.kind = Kind::kDataFrag,
                                           .writer = kWriter,
                                           .directed = true,
                                           .sequence = 0x1'0000'0002,
                                           .content = "fragment",
                                           .content_size = 8,
                                           .fragment = 1},
                            RtpsSubmessage{Kind::kHeartbeat, kWriter, false, 9}));
  }
}

TEST(RtpsParserTest, FollowsInfoSource) {
  const ros2::Guid other = TestGuid(2, 0x00000103);
  const RtpsDatagram datagram =
      Parse(RtpsBytes(kSender).Data(kWriter, 1).InfoSource(other).Data(kWriter, 2).bytes());

  EXPECT_EQ(datagram.sender, kSender);
  EXPECT_THAT(datagram.submessages, ElementsAre(RtpsSubmessage{Kind::kData, kWriter, false, 1},
                                                RtpsSubmessage{Kind::kData, other, false, 2}));
}

TEST(RtpsParserTest, PassesOverWhatItDoesNotRead) {
  const RtpsDatagram datagram = Parse(RtpsBytes(kSender)
                                          .Submessage(0x01, "")                    // PAD
                                          .Submessage(0x06, std::string(24, 'a'))  // ACKNACK
                                          .Submessage(0x0e, std::string(12, 'd'))  // INFO_DST
                                          .Submessage(0x80, "vendor's")
                                          .Data(kWriter, 3)
                                          .bytes());

  EXPECT_FALSE(datagram.malformed);
  EXPECT_THAT(datagram.submessages, ElementsAre(RtpsSubmessage{Kind::kData, kWriter, false, 3}));
}

TEST(RtpsParserTest, LengthZeroReachesToTheEnd) {
  const std::string data = RtpsBytes(kSender).Data(kWriter, 3).bytes();
  const std::string body = data.substr(kRtpsHeaderBytes + 4);

  const RtpsDatagram datagram = Parse(RtpsBytes(kSender).Submessage(0x15, body, 0).bytes());

  EXPECT_FALSE(datagram.malformed);
  EXPECT_THAT(datagram.submessages, ElementsAre(RtpsSubmessage{Kind::kData, kWriter, false, 3}));
}

TEST(RtpsParserTest, SecuredTrafficIsToldAndNotRead) {
  EXPECT_TRUE(Parse(RtpsBytes(kSender).Submessage(0x33, std::string(20, 's')).bytes()).secured);
  EXPECT_TRUE(Parse(RtpsBytes(kSender).Submessage(0x31, std::string(20, 's')).bytes()).secured);
  std::string encrypted = RtpsBytes(kSender).Data(kWriter, 3).bytes();
  encrypted[3] = 'X';

  const RtpsDatagram datagram = Parse(encrypted);

  EXPECT_TRUE(datagram.secured);
  EXPECT_EQ(datagram.sender, kSender);
  EXPECT_THAT(datagram.submessages, IsEmpty());
}

TEST(RtpsParserTest, OtherDatagramsAreNotRtps) {
  RtpsDatagram datagram;
  const std::string good = RtpsBytes(kSender).Data(kWriter, 3).bytes();
  std::string other_version = good;
  other_version[4] = '\x01';
  for (const std::string& bytes :
       {std::string(), std::string("RTPS"), good.substr(0, kRtpsHeaderBytes - 1),
        "rtps" + good.substr(4), other_version}) {
    EXPECT_FALSE(ParseRtps(bytes, bytes.size(), datagram));
  }
  EXPECT_FALSE(ParseRtps(good, good.size() - 1, datagram));
}

TEST(RtpsParserTest, WhatMakesNoSenseEndsTheDatagram) {
  const std::string short_data(19, 'd');
  const std::string short_frag(31, 'd');
  const std::string short_heartbeat(27, 'd');
  const RtpsBytes bad[] = {
      RtpsBytes(kSender).Data(kWriter, 1).Submessage(0x15, short_data).Data(kWriter, 2),
      RtpsBytes(kSender).Data(kWriter, 1).Submessage(0x16, short_frag).Data(kWriter, 2),
      RtpsBytes(kSender).Data(kWriter, 1).Submessage(0x07, short_heartbeat).Data(kWriter, 2),
      RtpsBytes(kSender).Data(kWriter, 1).Submessage(0x0c, "short").Data(kWriter, 2),
      // Past the end.
      RtpsBytes(kSender).Data(kWriter, 1).Submessage(0x80, "body", 5),
      RtpsBytes(kSender).Data(kWriter, 1).Submessage(0x15, short_data, 0xffff),
      // No room for a header.
      RtpsBytes(kSender).Data(kWriter, 1).Raw("abc"),
      // Sequence numbers that no writer has.
      RtpsBytes(kSender).Data(kWriter, 1).Data(kWriter, 0).Data(kWriter, 2),
      RtpsBytes(kSender).Data(kWriter, 1).Data(kWriter, -1).Data(kWriter, 2),
      RtpsBytes(kSender).Data(kWriter, 1).Heartbeat(kWriter, 1, -1).Data(kWriter, 2),
  };
  for (const RtpsBytes& each : bad) {
    const RtpsDatagram datagram = Parse(each.bytes());
    EXPECT_TRUE(datagram.malformed);
    EXPECT_FALSE(datagram.cut);
    EXPECT_THAT(datagram.submessages, ElementsAre(RtpsSubmessage{Kind::kData, kWriter, false, 1}));
  }
}

TEST(RtpsParserTest, AnEmptyHistoryHasAHeartbeat) {
  EXPECT_THAT(Parse(RtpsBytes(kSender).Heartbeat(kWriter, 1, 0).bytes()).submessages,
              ElementsAre(RtpsSubmessage{Kind::kHeartbeat, kWriter, false, 0}));
}

TEST(RtpsParserTest, ABodyMayEndBeyondWhatIsAtHandAHeaderNot) {
  const std::string whole =
      RtpsBytes(kSender).Data(kWriter, 1, 0, std::string(3000, 'p')).Data(kWriter, 2).bytes();
  RtpsDatagram datagram;

  ASSERT_TRUE(ParseRtps(absl::string_view(whole).substr(0, 1600), whole.size(), datagram));
  EXPECT_TRUE(datagram.cut);
  EXPECT_FALSE(datagram.malformed);
  EXPECT_THAT(datagram.submessages, ElementsAre(RtpsSubmessage{Kind::kData, kWriter, false, 1}));

  // Without the second submessage nothing is missed.
  const std::string one = RtpsBytes(kSender).Data(kWriter, 1, 0, std::string(3000, 'p')).bytes();
  ASSERT_TRUE(ParseRtps(absl::string_view(one).substr(0, 1600), one.size(), datagram));
  EXPECT_FALSE(datagram.cut);
}

TEST(RtpsParserTest, CutAnywhereGivesNothingThatWasNotThere) {
  const std::string whole = RtpsBytes(kSender)
                                .InfoTimestamp()
                                .Data(kWriter, 1)
                                .InfoSource(TestGuid(2, 0))
                                .DataFrag(kWriter, 2, kReader)
                                .Heartbeat(kWriter, 1, 2)
                                .bytes();
  const RtpsDatagram all = Parse(whole);
  for (size_t bytes = kRtpsHeaderBytes; bytes < whole.size(); ++bytes) {
    RtpsDatagram datagram;
    // Captured no more of it, or sent no more of it.
    ASSERT_TRUE(ParseRtps(absl::string_view(whole).substr(0, bytes), whole.size(), datagram));
    ASSERT_LE(datagram.submessages.size(), all.submessages.size());
    EXPECT_FALSE(datagram.malformed) << bytes;
    for (size_t i = 0; i < datagram.submessages.size(); ++i) {
      // Of the last one the content may be cut.
      RtpsSubmessage expected = all.submessages[i];
      expected.content = expected.content.substr(0, datagram.submessages[i].content.size());
      EXPECT_EQ(datagram.submessages[i], expected) << bytes;
    }
    ASSERT_TRUE(ParseRtps(absl::string_view(whole).substr(0, bytes), bytes, datagram));
    EXPECT_FALSE(datagram.cut) << bytes;
  }
}

TEST(RtpsParserTest, KnowsClassesOfEntities) {
  EXPECT_EQ(ClassOf(TestGuid(1, 0x00000103)), EntityClass::kUser);
  EXPECT_EQ(ClassOf(TestGuid(1, 0x00000102)), EntityClass::kUser);
  EXPECT_EQ(ClassOf(TestGuid(1, 0x000003c2)), EntityClass::kBuiltin);
  EXPECT_EQ(ClassOf(TestGuid(1, 0x00000042)), EntityClass::kVendor);
  EXPECT_TRUE(IsParticipantWriter(TestGuid(1, 0x000100c2)));
  EXPECT_FALSE(IsParticipantWriter(TestGuid(1, 0x000003c2)));
  EXPECT_TRUE(NamesNoEntity(kSender));
  EXPECT_FALSE(NamesNoEntity(kWriter));
}

// testdata/humble.pcap: of a recording of ROS 2 Humble nodes on the loopback interface, for each
// writer the first datagram in which it is named. testdata/humble_writers.txt: the writers of
// users among them, as the nodes announced them to each other, with their topics.
std::string ReadTestData(const std::string& name) {
  std::ifstream in(std::string(RIPS_SOURCE_DIR "/sensor_agent/wire/testdata/") + name,
                   std::ios::binary);
  EXPECT_TRUE(in.good()) << name;
  return std::string(std::istreambuf_iterator<char>(in), {});
}

TEST(RtpsParserTest, FindsTheWritersOfARecording) {
  const std::string pcap = ReadTestData("humble.pcap");
  constexpr size_t kFileHeader = 24;
  constexpr size_t kRecordHeader = 16;
  constexpr size_t kEthernet = 14;
  std::set<std::string> found;
  for (size_t at = kFileHeader; at + kRecordHeader <= pcap.size();) {
    uint32_t length = 0;  // of the capturing machine, little-endian
    for (int i = 3; i >= 0; --i) length = length * 256 + static_cast<uint8_t>(pcap[at + 8 + i]);
    const absl::string_view frame = absl::string_view(pcap).substr(at + kRecordHeader, length);
    at += kRecordHeader + length;
    UdpDatagram udp;
    ASSERT_TRUE(ParseIp(0x0800, frame.substr(kEthernet), udp));
    RtpsDatagram datagram;
    ASSERT_TRUE(ParseRtps(udp.bytes, udp.size, datagram));
    EXPECT_FALSE(datagram.malformed || datagram.cut);
    for (const RtpsSubmessage& each : datagram.submessages) {
      if (ClassOf(each.writer) == EntityClass::kUser) found.insert(ToString(each.writer));
    }
  }

  std::set<std::string> announced;
  std::istringstream lines(ReadTestData("humble_writers.txt"));
  for (std::string guid, topic; lines >> guid >> topic;) announced.insert(guid);
  EXPECT_EQ(announced.size(), 62);
  EXPECT_EQ(found, announced);
}

}  // namespace
}  // namespace rips::wire
