#include "sensor_agent/wire/wire_watch.h"

#include <optional>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/wire/rtps_bytes.h"

namespace rips::wire {
namespace {

using sensor::Finding;
using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using ::testing::UnorderedElementsAre;

constexpr int64_t kSecond = 1'000'000'000;
constexpr uint16_t kDomainPort = 7'400 + 250 * 42 + 11;
constexpr uint32_t kParticipantWriterId = 0x000100c2;
const ros2::Guid kRobot = TestGuid(1, 0x000001c1);
const ros2::Guid kWriter = TestGuid(1, 0x00000103);
const ros2::Guid kHidden = TestGuid(9, 0x00000103);

Locator At(uint8_t host, uint16_t port) {
  const uint8_t octets[] = {10, 0, 0, host};
  return {.address = FromV4(octets), .port = port};
}
Locator Loopback(uint16_t port) {
  const uint8_t octets[] = {127, 0, 0, 1};
  return {.address = FromV4(octets), .port = port};
}
Locator Multicast(uint16_t port) {
  const uint8_t octets[] = {239, 255, 0, 1};
  return {.address = FromV4(octets), .port = port};
}
const Locator kHome = At(1, 40'001);

auto Begins(const std::string& kind, const ros2::Guid& guid) {
  return AllOf(Field(&Finding::kind, kind), Field(&Finding::guid, guid),
               Field(&Finding::over, false));
}
auto IsOver(const std::string& kind, const ros2::Guid& guid) {
  return AllOf(Field(&Finding::kind, kind), Field(&Finding::guid, guid),
               Field(&Finding::over, true));
}

class WireWatchTest : public testing::Test {
 protected:
  WireWatchTest() { Reset({.domain = 42}); }

  void Reset(const WatchOptions& options) {
    watch_.emplace(options);
    Poll();
  }
  // The robot's participant, with a writer that we read.
  void MeetRobot() {
    watch_->ParticipantSeen(kRobot, {Multicast(7'401), kHome});
    watch_->WriterSeen(kWriter, "/cmd_vel");
    watch_->WriterRead(kWriter, now_ns_);
  }
  // One datagram of `writer`.
  void Send(const ros2::Guid& writer, const Locator& source, const Locator& to,
            uint64_t sequence = 1, uint16_t vendor = 0x0110) {
    ++packets_;
    TapReport report{.domain = 42,
                     .boottime_ns = now_ns_,
                     .counters = {.packets = packets_},
                     .local_addresses = {At(1, 0).address, At(5, 0).address}};
    report.traffic.push_back({.writer = writer,
                              .source = source,
                              .vendor = vendor,
                              .packets = 1,
                              .data = 1,
                              .data_last = sequence,
                              .first_packet = packets_,
                              .last_packet = packets_,
                              .destinations = {{to, 1}}});
    Traffic& traffic = report.traffic.back();
    traffic.data_least = sequence;
    traffic.numbers.Add(sequence);
    watch_->Take(report, now_ns_);
  }
  std::vector<Finding> Poll(bool settled = true) { return watch_->Poll(settled, now_ns_); }
  std::vector<Finding> PollAfter(int64_t ns) {
    now_ns_ += ns;
    return Poll();
  }

  int64_t now_ns_ = 100 * kSecond;
  uint64_t packets_ = 0;
  std::optional<WireWatch> watch_;
};

// ------------------------------------------------------------------------------- unicast_writer

TEST_F(WireWatchTest, FindsAWriterThatDiscoveryNeverShows) {
  Send(kHidden, At(9, 50'000), At(1, kDomainPort));
  EXPECT_THAT(PollAfter(kSecond), IsEmpty());
  Send(kHidden, At(9, 50'000), At(1, kDomainPort), 2);

  const std::vector<Finding> found = PollAfter(kSecond);

  ASSERT_THAT(found, ElementsAre(Begins("unicast_writer", kHidden)));
  EXPECT_EQ(found[0].detail,
            absl::StrCat("from 10.0.0.9:50000 to 10.0.0.1:", kDomainPort,
                         ", 2 datagrams: data of a writer that discovery does not show"));
  EXPECT_THAT(PollAfter(kSecond), IsEmpty());  // told once
}

TEST_F(WireWatchTest, ABurstThatIsOverIsStillFound) {
  Send(kHidden, At(9, 50'000), At(1, kDomainPort));

  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("unicast_writer", kHidden)));
  EXPECT_THAT(PollAfter(57 * kSecond), IsEmpty());
  EXPECT_THAT(PollAfter(kSecond), ElementsAre(IsOver("unicast_writer", kHidden)));
}

TEST_F(WireWatchTest, DiscoveryMayComeLaterThanData) {
  Send(kWriter, kHome, At(2, kDomainPort));
  EXPECT_THAT(PollAfter(kSecond), IsEmpty());
  MeetRobot();

  EXPECT_THAT(PollAfter(10 * kSecond), IsEmpty());
}

TEST_F(WireWatchTest, AFindingIsOverWhenDiscoveryShowsTheWriter) {
  Send(kWriter, kHome, At(2, kDomainPort));
  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("unicast_writer", kWriter)));
  MeetRobot();

  EXPECT_THAT(PollAfter(kSecond), ElementsAre(IsOver("unicast_writer", kWriter)));
}

TEST_F(WireWatchTest, FindsAnUnknownWriterOfAKnownParticipant) {
  MeetRobot();
  const ros2::Guid second = TestGuid(1, 0x00000203);
  Send(second, kHome, At(2, kDomainPort));

  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("unicast_writer", second)));
}

TEST_F(WireWatchTest, FindsAHiddenParticipantThatWritesNothing) {
  Send(TestGuid(9, kParticipantWriterId), At(9, 50'000), At(1, kDomainPort));
  Send(TestGuid(9, 0), At(9, 50'000), At(1, kDomainPort));

  EXPECT_THAT(PollAfter(2 * kSecond),
              ElementsAre(Begins("unicast_writer", TestGuid(9, 0x000001c1))));
}

TEST_F(WireWatchTest, AParticipantThatAnnouncesItselfGetsALongerGrace) {
  Send(TestGuid(9, kParticipantWriterId), At(9, 50'000), Multicast(7'400 + 250 * 42));
  Send(kHidden, At(9, 50'000), At(1, kDomainPort));

  EXPECT_THAT(PollAfter(9 * kSecond), IsEmpty());
  EXPECT_THAT(PollAfter(kSecond), ElementsAre(Begins("unicast_writer", kHidden)));
}

TEST_F(WireWatchTest, BuiltinWritersOfKnownParticipantsAreNoFinding) {
  MeetRobot();
  Send(TestGuid(1, kParticipantWriterId), kHome, Multicast(7'400 + 250 * 42));
  Send(TestGuid(1, 0x000003c2), kHome, At(2, kDomainPort));
  Send(TestGuid(1, 0x00000042), kHome, At(2, kDomainPort));
  Send(TestGuid(1, 0), kHome, At(2, kDomainPort));

  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
}

TEST_F(WireWatchTest, OtherDomainsAreNotOurs) {
  Send(kHidden, At(9, 50'000), At(1, 7'411));
  // A port the kernel gave to somebody we do not know.
  Send(kHidden, At(9, 50'000), At(1, 40'001));

  EXPECT_THAT(PollAfter(2 * kSecond), IsEmpty());
  EXPECT_EQ(watch_->counters().foreign, 2);
}

TEST_F(WireWatchTest, APortThatAKnownParticipantAdvertisesIsOurs) {
  MeetRobot();
  Send(kHidden, At(9, 50'000), kHome);

  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("unicast_writer", kHidden)));
}

TEST_F(WireWatchTest, ManyDestinationsDoNotHideOurs) {
  Send(kHidden, At(9, 50'000), At(1, 40'001));
  EXPECT_EQ(watch_->counters().foreign, 1);
  TapReport report{.domain = 42};
  report.traffic.push_back(
      {.writer = kHidden, .source = At(9, 50'000), .packets = 9, .data = 9, .elsewhere = 1});
  watch_->Take(report, now_ns_);

  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("unicast_writer", kHidden)));
}

TEST_F(WireWatchTest, WhatHasGoneIsKnownForAWhile) {
  MeetRobot();
  watch_->WriterGone(kWriter, now_ns_);
  watch_->ParticipantGone(kRobot, now_ns_);
  Poll();
  now_ns_ += 9 * kSecond;
  Send(kWriter, kHome, At(2, kDomainPort));
  EXPECT_THAT(Poll(), IsEmpty());

  // It was gone, and sends on.
  now_ns_ += kSecond;
  EXPECT_THAT(Poll(), IsEmpty());
  Send(kWriter, kHome, At(2, kDomainPort));
  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("unicast_writer", kWriter)));
}

TEST_F(WireWatchTest, WhoComesBackIsKnownAgain) {
  MeetRobot();
  watch_->Rediscover(now_ns_);
  MeetRobot();
  watch_->WriterGone(kWriter, now_ns_);
  watch_->WriterSeen(kWriter, "/cmd_vel");

  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
  Send(kWriter, kHome, At(2, kDomainPort));
  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
}

TEST_F(WireWatchTest, AfterRediscoveryWhatWasNotToldAgainIsGone) {
  MeetRobot();
  watch_->Rediscover(now_ns_);
  EXPECT_THAT(PollAfter(10 * kSecond), IsEmpty());
  Send(kWriter, kHome, At(2, kDomainPort));

  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("unicast_writer", kWriter)));
}

TEST_F(WireWatchTest, NothingBeginsBeforeDiscoveryHasSettled) {
  watch_.emplace(WatchOptions{.domain = 42});
  Send(kHidden, At(9, 50'000), At(1, kDomainPort));
  now_ns_ += 30 * kSecond;
  EXPECT_THAT(Poll(/*settled=*/false), IsEmpty());
  EXPECT_THAT(Poll(), IsEmpty());

  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("unicast_writer", kHidden)));
}

TEST_F(WireWatchTest, WhoAnnouncedItselfAndLeftBeforeDiscoveryHadSettledIsNoFinding) {
  watch_.emplace(WatchOptions{.domain = 42});
  Send(TestGuid(9, kParticipantWriterId), At(9, 50'000), Multicast(7'400 + 250 * 42));
  Send(kHidden, At(9, 50'000), At(1, kDomainPort));
  now_ns_ += kSecond;
  Poll();

  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
  // It has not left.
  Send(kHidden, At(9, 50'000), At(1, kDomainPort));
  EXPECT_THAT(PollAfter(kSecond), ElementsAre(Begins("unicast_writer", kHidden)));
}

// ------------------------------------------------------------------------------- spoofed_writer

TEST_F(WireWatchTest, FindsAnAddressThatIsNotAdvertised) {
  MeetRobot();
  Send(kWriter, kHome, At(2, kDomainPort), 1);
  Send(kWriter, At(9, 40'001), At(2, kDomainPort), 2);

  EXPECT_THAT(PollAfter(kSecond), IsEmpty());
  const std::vector<Finding> found = PollAfter(kSecond);
  ASSERT_THAT(found, ElementsAre(Begins("spoofed_writer", kWriter)));
  EXPECT_EQ(found[0].topic, "/cmd_vel");
  EXPECT_EQ(found[0].detail,
            "10.0.0.9:40001 sends under this name, an address that its participant does not "
            "advertise");
}

TEST_F(WireWatchTest, AForgeryStandsAsLongAsTheWriterLives) {
  MeetRobot();
  Send(kWriter, kHome, At(2, kDomainPort), 1);
  Send(kWriter, At(9, 40'001), At(2, kDomainPort), 2);
  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("spoofed_writer", kWriter)));

  // The forger is long gone, and what it did to readers lasts.
  EXPECT_THAT(PollAfter(600 * kSecond), IsEmpty());
  // Discovery that we ask again changes nothing.
  watch_->Rediscover(now_ns_);
  MeetRobot();
  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());

  watch_->WriterGone(kWriter, now_ns_);
  EXPECT_THAT(PollAfter(kSecond), ElementsAre(IsOver("spoofed_writer", kWriter)));
  MeetRobot();
  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
}

TEST_F(WireWatchTest, AForgeryEndsWithItsParticipant) {
  MeetRobot();
  Send(kWriter, kHome, At(2, kDomainPort), 1);
  Send(kWriter, At(9, 40'001), At(2, kDomainPort), 2);
  Send(TestGuid(1, 0x000003c2), At(9, 40'002), At(2, kDomainPort));
  EXPECT_THAT(PollAfter(2 * kSecond), UnorderedElementsAre(Begins("spoofed_writer", kWriter),
                                                           Begins("spoofed_writer", kRobot)));
  watch_->ParticipantGone(kRobot, now_ns_);
  watch_->WriterGone(kWriter, now_ns_);
  watch_->ParticipantSeen(kRobot, {kHome});

  EXPECT_THAT(PollAfter(kSecond), UnorderedElementsAre(IsOver("spoofed_writer", kWriter),
                                                       IsOver("spoofed_writer", kRobot)));
}

TEST_F(WireWatchTest, AForgedAnnouncementIsFoundToo) {
  MeetRobot();
  Send(TestGuid(1, kParticipantWriterId), At(9, 40'001), Multicast(7'400 + 250 * 42));

  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("spoofed_writer", kRobot)));
}

TEST_F(WireWatchTest, AHostMaySendToItselfFromAnyOfItsAddresses) {
  MeetRobot();  // at 10.0.0.1, which is local as 10.0.0.5 is
  Send(kWriter, kHome, At(2, kDomainPort));
  Send(kWriter, At(5, 40'002), At(1, kDomainPort));
  Send(kWriter, Loopback(40'003), Loopback(kDomainPort));

  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
}

TEST_F(WireWatchTest, FindsASecondPortThatIsUsedByTurns) {
  MeetRobot();
  Send(kWriter, kHome, At(2, kDomainPort), 1);
  Send(kWriter, At(1, 40'009), At(2, kDomainPort), 2);
  EXPECT_THAT(PollAfter(2 * kSecond), IsEmpty());  // as if it had moved there
  Send(kWriter, kHome, At(2, kDomainPort), 3);

  const std::vector<Finding> found = PollAfter(kSecond);

  ASSERT_THAT(found, ElementsAre(Begins("spoofed_writer", kWriter)));
  EXPECT_EQ(found[0].detail,
            "10.0.0.1:40009 sends under this name, which its participant uses from 10.0.0.1:40001");
}

TEST_F(WireWatchTest, AProcessStartedAgainUnderItsNameMayUseAnotherPort) {
  MeetRobot();
  Send(kWriter, kHome, At(2, kDomainPort), 1);
  watch_->ParticipantGone(kRobot, now_ns_);
  Send(kWriter, At(1, 40'009), At(2, kDomainPort), 1);
  watch_->ParticipantSeen(kRobot, {At(1, 40'009)});
  Send(kWriter, At(1, 40'009), At(2, kDomainPort), 2);

  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
}

TEST_F(WireWatchTest, OtherMiddlewareMayUseSeveralPorts) {
  const std::pair<uint16_t, uint16_t> ports_of_vendors[] = {{0x010f, 2}, {0x0101, 8}};
  for (const auto& [vendor, ports] : ports_of_vendors) {
    Reset({.domain = 42});
    MeetRobot();
    for (int round = 0; round < 2; ++round) {
      for (uint16_t i = 1; i <= ports; ++i) Send(kWriter, At(1, i), At(2, 20), 1, vendor);
    }
    EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());

    Send(kWriter, At(1, 99), At(2, 20), 1, vendor);
    for (uint16_t i = 1; i <= ports; ++i) Send(kWriter, At(1, i), At(2, 20), 1, vendor);
    EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("spoofed_writer", kWriter)));
  }
}

TEST_F(WireWatchTest, AnotherVendorIdDoesNotWidenWhatCycloneMay) {
  MeetRobot();
  Send(kWriter, kHome, At(2, kDomainPort), 1);
  Send(kWriter, At(1, 40'009), At(2, kDomainPort), 2, 0x010f);
  Send(kWriter, kHome, At(2, kDomainPort), 3);

  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("spoofed_writer", kWriter)));
}

TEST_F(WireWatchTest, WithoutAdvertisedAddressesTheFirstOneCounts) {
  watch_->ParticipantSeen(kRobot, {});
  watch_->WriterSeen(kWriter, "/cmd_vel");
  Send(kWriter, At(7, 1), At(2, kDomainPort), 1);
  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
  Send(kWriter, At(9, 1), At(2, kDomainPort), 2);

  EXPECT_THAT(PollAfter(2 * kSecond), ElementsAre(Begins("spoofed_writer", kWriter)));
}

TEST_F(WireWatchTest, AnotherTapCountsAnew) {
  MeetRobot();
  packets_ = 100;
  Send(kWriter, kHome, At(2, kDomainPort), 1);
  watch_->ParticipantGone(kRobot, now_ns_);
  watch_->TapChanged();
  packets_ = 0;
  watch_->ParticipantSeen(kRobot, {At(1, 40'009)});
  Send(kWriter, At(1, 40'009), At(2, kDomainPort), 2);

  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
}

// -------------------------------------------------------------------------------- directed_data

TEST_F(WireWatchTest, FindsDataThatGoesPastOurReader) {
  MeetRobot();
  now_ns_ += 3 * kSecond;  // it knows our reader
  std::vector<Finding> found;
  uint64_t sequence = 0;
  for (int i = 0; i < 20 && found.empty(); ++i) {
    Send(kWriter, kHome, At(2, kDomainPort), sequence += 1);
    Send(kWriter, kHome, At(2, kDomainPort), sequence += 1);
    found = PollAfter(kSecond / 5);
  }

  ASSERT_THAT(found, ElementsAre(Begins("directed_data", kWriter)));
  EXPECT_EQ(found[0].topic, "/cmd_vel");
  EXPECT_THAT(found[0].detail, HasSubstr(" samples on the wire do not come to our reader"));
  EXPECT_TRUE(watch_->Misses(kWriter) && watch_->MissesSome());
  for (int i = 0; i < 20 && !found[0].over; ++i) {
    watch_->Received(kWriter, ++sequence);
    Send(kWriter, kHome, At(2, kDomainPort), sequence);
    if (auto news = PollAfter(kSecond / 5); !news.empty()) found = news;
  }
  EXPECT_THAT(found, ElementsAre(IsOver("directed_data", kWriter)));
  EXPECT_FALSE(watch_->Misses(kWriter) || watch_->MissesSome());
}

TEST_F(WireWatchTest, WritersThatWeDoNotReadAreNotMissed) {
  watch_->ParticipantSeen(kRobot, {kHome});
  watch_->WriterSeen(kWriter, "/rosout");
  for (uint64_t i = 1; i <= 50; ++i) {
    Send(kWriter, kHome, At(2, kDomainPort), i);
    EXPECT_THAT(PollAfter(kSecond / 5), IsEmpty());
  }
  // Nor those that we read no longer.
  watch_->WriterRead(kWriter, now_ns_);
  watch_->SetReaders([](const ros2::Guid&) { return false; }, now_ns_);
  for (uint64_t i = 51; i <= 100; ++i) {
    Send(kWriter, kHome, At(2, kDomainPort), i);
    EXPECT_THAT(PollAfter(kSecond / 5), IsEmpty());
  }
}

TEST_F(WireWatchTest, SamplesThatOurQueuesLostAreNotMissed) {
  MeetRobot();
  for (uint64_t i = 1; i <= 100; ++i) {
    Send(kWriter, kHome, At(2, kDomainPort), i);
    EXPECT_THAT(PollAfter(kSecond / 5), IsEmpty());
    watch_->ReceivedAndLost();
  }
}

// --------------------------------------------------------------------------------- two_contents

TEST_F(WireWatchTest, FindsTwoContentsOfASample) {
  MeetRobot();
  TapReport report{.domain = 42};
  report.traffic.push_back({.writer = kWriter,
                            .source = kHome,
                            .packets = 2,
                            .data = 2,
                            .destinations = {{At(2, kDomainPort), 2}},
                            .conflicts = 1,
                            .conflict_number = 7,
                            .conflict_size = 52,
                            .conflict_to = At(2, kDomainPort)});
  watch_->Take(report, now_ns_);

  const std::vector<Finding> found = PollAfter(kSecond);
  ASSERT_THAT(found, ElementsAre(Begins("two_contents", kWriter)));
  EXPECT_EQ(found[0].topic, "/cmd_vel");
  EXPECT_EQ(found[0].detail, absl::StrCat("sample 7 goes to 10.0.0.2:", kDomainPort,
                                          " with another content than elsewhere"));
  const std::vector<SecondContent> second = watch_->TakeSecondContents();
  ASSERT_THAT(second, SizeIs(1));
  EXPECT_EQ(second[0].number, 7);
  EXPECT_EQ(second[0].size, 52);
  // As long as the writer lives.
  EXPECT_THAT(PollAfter(600 * kSecond), IsEmpty());
  watch_->WriterGone(kWriter, now_ns_);
  EXPECT_THAT(PollAfter(kSecond), ElementsAre(IsOver("two_contents", kWriter)));
}

// --------------------------------------------------------------------------------------- limits

TEST_F(WireWatchTest, ParticipantsOnTheWireBeyondTheLimitAreCounted) {
  Reset({.domain = 42, .participants = 2});
  for (uint8_t i = 1; i <= 3; ++i) Send(TestGuid(i, 0x103), At(9, i), At(1, kDomainPort));

  EXPECT_EQ(watch_->counters().dropped, 1);
  EXPECT_THAT(PollAfter(2 * kSecond), SizeIs(2));
  // When those have been silent for long there is room again.
  PollAfter(60 * kSecond);
  Send(TestGuid(3, 0x103), At(9, 3), At(1, kDomainPort));
  EXPECT_EQ(watch_->counters().dropped, 1);
}

TEST_F(WireWatchTest, UnknownWritersOfAParticipantBeyondTheLimitAreCounted) {
  Reset({.domain = 42, .writers_each = 2});
  for (uint32_t i = 1; i <= 3; ++i) Send(TestGuid(9, 256 * i + 3), At(9, 1), At(1, kDomainPort));

  EXPECT_EQ(watch_->counters().dropped, 1);
  EXPECT_THAT(PollAfter(2 * kSecond), SizeIs(2));
}

TEST_F(WireWatchTest, SourcesOfAParticipantBeyondTheLimitAreCounted) {
  Reset({.domain = 42, .sources_each = 2});
  MeetRobot();
  for (uint16_t i = 1; i <= 3; ++i) Send(kWriter, At(1, i), At(2, kDomainPort));

  EXPECT_EQ(watch_->counters().dropped, 1);
}

TEST_F(WireWatchTest, FindingsBeyondTheLimitAreCounted) {
  Reset({.domain = 42, .findings = 2});
  for (uint8_t i = 1; i <= 3; ++i) Send(TestGuid(i, 0x103), At(9, i), At(1, kDomainPort));

  EXPECT_THAT(PollAfter(2 * kSecond), SizeIs(2));
  EXPECT_EQ(watch_->counters().findings_dropped, 1);
  EXPECT_THAT(watch_->standing(), SizeIs(2));
}

TEST_F(WireWatchTest, BlindBeyondTheLimitsOfDiscovery) {
  Reset({.domain = 42, .known_writers = 1});
  MeetRobot();
  EXPECT_FALSE(watch_->blind());
  watch_->WriterSeen(kHidden, "/one_too_many");
  Send(kHidden, At(9, 50'000), At(1, kDomainPort));

  EXPECT_TRUE(watch_->blind());
  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());

  Reset({.domain = 42, .known_participants = 1});
  MeetRobot();
  watch_->ParticipantSeen(TestGuid(9, 0x1c1), {});
  EXPECT_TRUE(watch_->blind());
}

TEST_F(WireWatchTest, SeesAgainWhenThereIsRoom) {
  Reset({.domain = 42, .known_writers = 4});
  watch_->ParticipantSeen(kRobot, {kHome});
  for (uint32_t i = 1; i <= 5; ++i) watch_->WriterSeen(TestGuid(1, 256 * i + 3), "/topic");
  ASSERT_TRUE(watch_->blind());
  EXPECT_FALSE(watch_->CanSeeAgain());
  Send(kHidden, At(9, 50'000), At(1, kDomainPort));

  watch_->WriterGone(TestGuid(1, 256 + 3), now_ns_);
  PollAfter(10 * kSecond);
  ASSERT_TRUE(watch_->CanSeeAgain());
  watch_->Rediscover(now_ns_);
  EXPECT_FALSE(watch_->blind());
  Send(TestGuid(1, 256 * 5 + 3), kHome, At(2, kDomainPort));
  EXPECT_THAT(PollAfter(kSecond), IsEmpty()) << "discovery is still being told";
  watch_->ParticipantSeen(kRobot, {kHome});
  for (uint32_t i = 2; i <= 5; ++i) watch_->WriterSeen(TestGuid(1, 256 * i + 3), "/topic");
  EXPECT_FALSE(watch_->blind());

  EXPECT_THAT(PollAfter(5 * kSecond), ElementsAre(Begins("unicast_writer", kHidden)));
}

TEST_F(WireWatchTest, IsBlindAgainIfThereIsTooMuchAgain) {
  Reset({.domain = 42, .known_participants = 1});
  watch_->ParticipantSeen(kRobot, {kHome});
  watch_->ParticipantSeen(TestGuid(9, 0x1c1), {});
  EXPECT_FALSE(watch_->CanSeeAgain());
  watch_->Rediscover(now_ns_);
  watch_->ParticipantSeen(kRobot, {kHome});
  watch_->ParticipantSeen(TestGuid(9, 0x1c1), {});

  EXPECT_TRUE(watch_->blind());
}

TEST_F(WireWatchTest, WhatIsUnknownIsIgnoredWhenItGoes) {
  watch_->ParticipantGone(kRobot, now_ns_);
  watch_->WriterGone(kWriter, now_ns_);
  watch_->WriterRead(kWriter, now_ns_);

  EXPECT_THAT(PollAfter(20 * kSecond), IsEmpty());
}

}  // namespace
}  // namespace rips::wire
