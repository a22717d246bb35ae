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

constexpr int64_t kNowNs = 100'000'000'000;
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
    table_.Add(parsed, source, to, kNowNs);
  }

  TrafficTable table_{SipKey{.low = 1}, {.entries = 3, .content_buckets_log2 = 4}};
};

NumberSet Numbers(std::vector<NumberRun> runs) {
  NumberSet numbers(kRunsMax, /*keep=*/true);
  for (const NumberRun& run : runs) numbers.Add(run);
  return numbers;
}

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
                                                 .destinations = {{At(2, 20), 1}, {At(3, 30), 1}},
                                                 .data_least = 4,
                                                 .heartbeat_least = 6,
                                                 .numbers = Numbers({{4, 6}})},
                                         Traffic{.writer = kOther,
                                                 .source = At(1, 10),
                                                 .vendor = 0x0110,
                                                 .packets = 1,
                                                 .data = 1,
                                                 .data_last = 1,
                                                 .first_packet = 2,
                                                 .last_packet = 2,
                                                 .destinations = {{At(2, 20), 1}},
                                                 .data_least = 1,
                                                 .numbers = Numbers({{1, 1}})}));
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
  table_.Add(cut, At(1, 10), At(2, 20), kNowNs);
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

TEST_F(TrafficTableTest, TellsNumbersAsFarAsThereIsRoom) {
  for (int64_t i = 1; i <= 100; ++i) {
    Add(RtpsBytes(kSender).Data(kWriter, i).Data(kWriter, 1'000 * i), At(1, 10), At(2, 20));
  }
  Add(RtpsBytes(kSender).Heartbeat(kWriter, 7, 50).Heartbeat(kWriter, 1, 0).Gap(kWriter, 1, 21),
      At(1, 10), At(2, 20));

  const std::vector<Traffic> traffic = table_.Take();
  ASSERT_THAT(traffic, SizeIs(1));
  EXPECT_EQ(traffic[0].data_least, 1);
  EXPECT_EQ(traffic[0].data_last, 100'000);
  EXPECT_EQ(traffic[0].heartbeat_least, 50);
  EXPECT_EQ(traffic[0].dropped_last, 20);
  EXPECT_THAT(traffic[0].numbers.runs(), SizeIs(kRunsMax));
  EXPECT_EQ(traffic[0].numbers.CountIn({1, 100}), 100);
}

TEST_F(TrafficTableTest, FindsTwoContentsOfOneNumberInWhateverInterval) {
  Add(RtpsBytes(kSender).Sample(kWriter, 1, "to the sensor"), At(1, 10), At(2, 20));
  EXPECT_THAT(table_.Take(), ElementsAre(Field(&Traffic::conflicts, 0)));
  Add(RtpsBytes(kSender).InfoTimestamp().Sample(kWriter, 1, "to the sensor"), At(1, 10), At(2, 20));
  Add(RtpsBytes(kSender).Sample(kWriter, 1, "to the victim!"), At(1, 10), At(3, 30));

  const std::vector<Traffic> traffic = table_.Take();
  ASSERT_THAT(traffic, SizeIs(1));
  EXPECT_EQ(traffic[0].conflicts, 1);
  EXPECT_EQ(traffic[0].conflict_number, 1);
  EXPECT_EQ(traffic[0].conflict_size, 14);
  EXPECT_EQ(traffic[0].conflict_to, At(3, 30));
}

TEST_F(TrafficTableTest, InlineQosAndKeysOfBuiltinWritersAreNoContents) {
  const std::string qos =
      RtpsBytes(kSender).Parameter(0x70, "hash of the key.") + RtpsBytes(kSender).Parameter(1, "");
  Add(RtpsBytes(kSender).Sample(kWriter, 1, "same"), At(1, 10), At(2, 20));
  Add(RtpsBytes(kSender).Sample(kWriter, 1, "same", qos), At(1, 10), At(3, 30));
  // A participant announces other locators on each network.
  const ros2::Guid announces = TestGuid(1, 0x000100c2);
  Add(RtpsBytes(kSender).Sample(announces, 1, "here"), At(1, 10), At(2, 20));
  Add(RtpsBytes(kSender).Sample(announces, 1, "there"), At(1, 10), At(3, 30));

  EXPECT_THAT(table_.Take(),
              ElementsAre(Field(&Traffic::conflicts, 0), Field(&Traffic::conflicts, 0)));
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
