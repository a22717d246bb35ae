#include "sensor_agent/wire/traffic.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/wire/rtps_bytes.h"

namespace rips::wire {
namespace {

using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::IsEmpty;
using ::testing::SizeIs;

const ros2::Guid kSender = TestGuid(1, 0);
const ros2::Guid kWriter = TestGuid(1, 0x00000103);
const ros2::Guid kOther = TestGuid(1, 0x00000203);

Locator At(uint8_t host, uint16_t port) {
  const uint8_t octets[] = {10, 0, 0, host};
  return {.address = FromV4(octets), .port = port};
}

class TrafficTableTest : public testing::Test {
 protected:
  void Add(const RtpsBytes& datagram, const Locator& source, const Locator& to) {
    RtpsDatagram parsed;
    ASSERT_TRUE(ParseRtps(datagram.bytes(), datagram.bytes().size(), parsed));
    table_.Add(parsed, source, to);
  }

  TrafficTable table_{TrafficTable::Limits{.entries = 3}};
};

TEST_F(TrafficTableTest, SumsUpPerWriterAndSource) {
  Add(RtpsBytes(kSender).Data(kWriter, 5).Data(kWriter, 6, 0x204).Heartbeat(kWriter, 1, 6),
      At(1, 10), At(2, 20));
  Add(RtpsBytes(kSender).Data(kOther, 1), At(1, 10), At(2, 20));
  Add(RtpsBytes(kSender).DataFrag(kWriter, 4), At(1, 10), At(3, 30));

  EXPECT_THAT(table_.Take(), ElementsAre(Traffic{.writer = kWriter,
                                                 .source = At(1, 10),
                                                 .vendor = 0x0110,
                                                 .packets = 2,
                                                 .data = 2,
                                                 .data_frag = 1,
                                                 .heartbeat = 1,
                                                 .directed = 1,
                                                 .data_last = 6,
                                                 .heartbeat_last = 6,
                                                 .first_packet = 1,
                                                 .last_packet = 3,
                                                 .destinations = {{At(2, 20), 1}, {At(3, 30), 1}}},
                                         Traffic{.writer = kOther,
                                                 .source = At(1, 10),
                                                 .vendor = 0x0110,
                                                 .packets = 1,
                                                 .data = 1,
                                                 .data_last = 1,
                                                 .first_packet = 2,
                                                 .last_packet = 2,
                                                 .destinations = {{At(2, 20), 1}}}));
  EXPECT_THAT(table_.Take(), IsEmpty());
  EXPECT_EQ(table_.counters(), TapCounters{.packets = 3});
}

TEST_F(TrafficTableTest, TellsSourcesApart) {
  Add(RtpsBytes(kSender).Data(kWriter, 1), At(1, 10), At(2, 20));
  Add(RtpsBytes(kSender).Data(kWriter, 2), At(1, 11), At(2, 20));

  EXPECT_THAT(table_.Take(),
              ElementsAre(Field(&Traffic::source, At(1, 10)), Field(&Traffic::source, At(1, 11))));
}

TEST_F(TrafficTableTest, ASenderWithoutAWriterIsThereToo) {
  Add(RtpsBytes(kSender).Submessage(0x06, std::string(24, 'a')), At(1, 10), At(2, 20));
  Add(RtpsBytes(kSender).InfoSource(TestGuid(2, 0)).Data(TestGuid(2, 0x103), 1), At(1, 10),
      At(2, 20));
  Add(RtpsBytes(kSender).Submessage(0x33, std::string(24, 's')), At(1, 10), At(2, 20));

  EXPECT_THAT(table_.Take(),
              ElementsAre(testing::AllOf(Field(&Traffic::writer, kSender),
                                         Field(&Traffic::packets, 3), Field(&Traffic::secured, 1)),
                          Field(&Traffic::writer, TestGuid(2, 0x103))));
}

TEST_F(TrafficTableTest, CountsWhatMakesNoSenseAndWhatIsBeyond) {
  Add(RtpsBytes(kSender).Raw("x"), At(1, 10), At(2, 20));
  RtpsDatagram cut;
  const std::string long_one =
      RtpsBytes(kSender).Data(kWriter, 1, 0, std::string(2000, 'p')).Data(kWriter, 2).bytes();
  ASSERT_TRUE(ParseRtps(absl::string_view(long_one).substr(0, 1600), long_one.size(), cut));
  table_.Add(cut, At(1, 10), At(2, 20));
  table_.AddKernelDrops(4);

  EXPECT_EQ(table_.counters(),
            (TapCounters{.packets = 2, .malformed = 1, .cut = 1, .kernel_drops = 4}));
}

TEST_F(TrafficTableTest, RefusesWritersBeyondItsLimitAndCountsTheirDatagrams) {
  for (uint8_t participant = 1; participant <= 4; ++participant) {
    const ros2::Guid writer = TestGuid(participant, 0x103);
    Add(RtpsBytes(TestGuid(participant, 0)).Data(writer, 1).Data(writer, 2), At(1, 10), At(2, 20));
  }
  Add(RtpsBytes(kSender).Data(kWriter, 9), At(1, 10), At(2, 20));

  EXPECT_EQ(table_.counters(), (TapCounters{.packets = 5, .table_drops = 1}));
  const std::vector<Traffic> traffic = table_.Take();
  ASSERT_THAT(traffic, SizeIs(3));
  EXPECT_EQ(traffic.front().data_last, 9);  // those that were there go on
  // The next interval has room again.
  Add(RtpsBytes(TestGuid(4, 0)).Data(TestGuid(4, 0x103), 3), At(1, 10), At(2, 20));
  EXPECT_THAT(table_.Take(), SizeIs(1));
}

TEST_F(TrafficTableTest, KeepsTheFirstDestinations) {
  for (uint16_t i = 0; i < kDestinationsMax + 3; ++i) {
    Add(RtpsBytes(kSender).Data(kWriter, 1), At(1, 10), At(2, static_cast<uint16_t>(100 + i)));
  }

  const std::vector<Traffic> traffic = table_.Take();
  ASSERT_THAT(traffic, SizeIs(1));
  EXPECT_THAT(traffic[0].destinations, SizeIs(kDestinationsMax));
  EXPECT_EQ(traffic[0].elsewhere, 3);
}

}  // namespace
}  // namespace rips::wire
