// Forged datagrams and honest ones, from their bytes to what WireWatch says.
#include <optional>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/wire/rtps_bytes.h"
#include "sensor_agent/wire/traffic.h"
#include "sensor_agent/wire/wire_watch.h"

namespace rips::wire {
namespace {

using sensor::Finding;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int64_t kStepNs = 200 * kNanosPerMilli;
constexpr int64_t kFar = int64_t{1} << 40;
constexpr uint16_t kDomainPort = 7'400 + 250 * 42 + 11;
const ros2::Guid kRobot = TestGuid(1, 0x000001c1);
const ros2::Guid kWriter = TestGuid(1, 0x00000103);
const ros2::Guid kRequests = TestGuid(1, 0x00000203);
const ros2::Guid kEndpoints = TestGuid(1, 0x000003c2);

Locator At(uint8_t host, uint16_t port) {
  const uint8_t octets[] = {10, 0, 0, host};
  return {.address = FromV4(octets), .port = port};
}
const Locator kHome = At(1, 40'001);
const Locator kSensor = At(1, kDomainPort);
const Locator kVictim = At(2, kDomainPort);

class ForgedTrafficTest : public testing::Test {
 protected:
  ForgedTrafficTest() { Start({.domain = 42}); }

  void Start(const WatchOptions& options) {
    watch_.emplace(options);
    watch_->Poll(/*settled=*/true, now_ns_);
    watch_->ParticipantSeen(kRobot, {kHome});
    watch_->WriterSeen(kWriter, "/cmd_vel");
    watch_->WriterSeen(kRequests, "/nav/change_state");
    watch_->WriterRead(kWriter, now_ns_);
    now_ns_ += 3 * kNanosPerSecond;
  }
  void Send(const RtpsBytes& datagram, const Locator& to, const Locator& from = kHome) {
    RtpsDatagram parsed;
    ASSERT_TRUE(ParseRtps(datagram.bytes(), datagram.bytes().size(), parsed));
    table_.Add(parsed, from, to, now_ns_);
  }
  // The next interval of the tap.
  std::vector<Finding> Step() {
    now_ns_ += kStepNs;
    TapReport report{.domain = 42,
                     .boottime_ns = now_ns_,
                     .local_addresses = {At(1, 0).address},
                     .traffic = table_.Take()};
    watch_->Take(report, now_ns_);
    for (const Jump& jump : watch_->TakeJumps()) jumps_.push_back(jump);
    return watch_->Poll(/*settled=*/true, now_ns_);
  }
  static RtpsBytes Sample(int64_t number, const std::string& payload = "twist") {
    return RtpsBytes(TestGuid(1, 0)).InfoTimestamp().Sample(kWriter, number, payload);
  }

  int64_t now_ns_ = 100 * kNanosPerSecond;
  TrafficTable table_{SipKey{.low = 1}, {.content_buckets_log2 = 8}};
  std::optional<WireWatch> watch_;
  std::vector<Jump> jumps_;
};

TEST_F(ForgedTrafficTest, OnePacketThatMakesTheSensorDeaf) {
  Send(Sample(1), kSensor);
  Send(Sample(1), kVictim);
  Step();
  Send(Sample(kFar), kSensor);
  Step();

  ASSERT_THAT(jumps_, ElementsAre(Field(&Jump::writer, kWriter)));
  EXPECT_EQ(jumps_[0].detail,
            "on the wire from 10.0.0.1:40001: number 1099511627776 right after 1");
}

TEST_F(ForgedTrafficTest, AlsoAsTheFirstPacketAndBeforeDiscoveryShowsTheWriter) {
  const ros2::Guid late = TestGuid(1, 0x00000303);
  Send(RtpsBytes(TestGuid(1, 0)).Sample(late, kFar, "twist"), kSensor);
  Step();
  EXPECT_THAT(jumps_, IsEmpty());
  watch_->WriterSeen(late, "/cmd_vel");
  Send(RtpsBytes(TestGuid(1, 0)).Sample(late, 1, "twist"), kVictim);
  Step();

  ASSERT_THAT(jumps_, ElementsAre(Field(&Jump::writer, late)));
  EXPECT_THAT(jumps_[0].detail, HasSubstr("number 1 after 1099511627776"));
}

TEST_F(ForgedTrafficTest, AForgedHeartbeatOfALatchedTopic) {
  Send(Sample(1), kSensor);
  Step();
  Send(RtpsBytes(TestGuid(1, 0)).Heartbeat(kWriter, kFar, kFar), kSensor, At(1, 5'555));
  Step();
  EXPECT_THAT(jumps_, ElementsAre(Field(&Jump::writer, kWriter)));
}

TEST_F(ForgedTrafficTest, AForgedHeartbeatToThoseWhoServe) {
  // A writer that we do not read.
  const RtpsBytes request = RtpsBytes(TestGuid(1, 0)).Sample(kRequests, 12, "request");
  Send(request, kVictim);
  Step();
  Send(RtpsBytes(TestGuid(1, 0)).Heartbeat(kRequests, kFar, kFar), kVictim, At(1, 5'555));
  Step();
  ASSERT_THAT(jumps_, ElementsAre(Field(&Jump::writer, kRequests)));
  EXPECT_TRUE(jumps_[0].writer.SamePrefix(kRobot));
}

TEST_F(ForgedTrafficTest, ForgedDiscovery) {
  Send(RtpsBytes(TestGuid(1, 0)).Sample(kEndpoints, 3, "a writer"), kSensor);
  Step();
  Send(RtpsBytes(TestGuid(1, 0)).Gap(kEndpoints, 4, kFar), kSensor);
  Step();
  EXPECT_THAT(jumps_, ElementsAre(Field(&Jump::writer, kEndpoints)));

  // By less: the next HEARTBEAT of the true one gives it away.
  jumps_.clear();
  Send(RtpsBytes(TestGuid(1, 0)).Sample(kEndpoints, 900, "a writer"), kSensor);
  Step();
  Send(RtpsBytes(TestGuid(1, 0)).Heartbeat(kEndpoints, 1, 4), kSensor);
  Step();
  ASSERT_THAT(jumps_, ElementsAre(Field(&Jump::writer, kEndpoints)));
  EXPECT_THAT(jumps_[0].detail, HasSubstr("last number by HEARTBEAT 4 after 900"));
}

TEST_F(ForgedTrafficTest, UnknownParticipantsAreNoJumps) {
  Send(RtpsBytes(TestGuid(9, 0)).Sample(TestGuid(9, 0x103), 1, "twist"), kVictim);
  Send(RtpsBytes(TestGuid(9, 0)).Sample(TestGuid(9, 0x103), kFar, "twist"), kVictim);
  Step();
  EXPECT_THAT(jumps_, IsEmpty());
}

TEST_F(ForgedTrafficTest, AProcessThatCameBackUnderItsNameCountsFromOne) {
  Send(Sample(5'000'000), kSensor);
  Send(RtpsBytes(TestGuid(1, 0)).Heartbeat(kEndpoints, 1, 900), kSensor);
  Step();
  watch_->ParticipantGone(kRobot, now_ns_);
  watch_->WriterGone(kWriter, now_ns_);
  watch_->ParticipantSeen(kRobot, {kHome});
  watch_->WriterSeen(kWriter, "/cmd_vel");
  Send(Sample(1), kSensor);
  Send(RtpsBytes(TestGuid(1, 0)).Heartbeat(kEndpoints, 1, 1), kSensor);
  Step();
  EXPECT_THAT(jumps_, IsEmpty());
}

TEST_F(ForgedTrafficTest, DeafByAJumpThatAWriterMightMake) {
  std::vector<Finding> found;
  watch_->Received(kWriter, 500'000);
  Send(Sample(500'000), kSensor);
  int64_t number = 0;
  int steps = 0;
  while (found.empty()) {
    ASSERT_LT(++steps, 5 * 5);
    for (int i = 0; i < 10; ++i) Send(Sample(++number), kVictim);
    found = Step();
  }
  EXPECT_THAT(found, ElementsAre(Field(&Finding::kind, "directed_data")));
  EXPECT_THAT(jumps_, IsEmpty());
}

TEST_F(ForgedTrafficTest, TwoContentsUnderOneNumber) {
  Send(Sample(1, "the attack"), kVictim);
  Send(Sample(1, "the benign"), kSensor);

  EXPECT_THAT(Step(), ElementsAre(Field(&Finding::kind, "two_contents")));
  const auto second = watch_->TakeSecondContents();
  ASSERT_THAT(second, ElementsAre(Field(&SecondContent::writer, kWriter)));
  EXPECT_EQ(second[0].size, 10);
  EXPECT_TRUE(watch_->Misses(kWriter));
}

TEST_F(ForgedTrafficTest, EncryptedPayloadsMayDifferEachTime) {
  Start({.domain = 42, .secured = true});
  ros2::Guid participant = TestGuid(7, 0x1c1);
  ros2::Guid writer = TestGuid(7, 0x103);
  participant.bytes[0] = writer.bytes[0] = 0x81;
  watch_->ParticipantSeen(participant, {kHome});
  watch_->WriterSeen(writer, "/cmd_vel");
  for (const char* payload : {"session key 1", "session key 2"}) {
    Send(RtpsBytes(writer).Sample(writer, 1, payload), kVictim);
  }
  EXPECT_THAT(Step(), IsEmpty());
  // Without security nothing is encrypted.
  Start({.domain = 42});
  watch_->ParticipantSeen(participant, {kHome});
  watch_->WriterSeen(writer, "/cmd_vel");
  for (const char* payload : {"session key 1", "session key 2"}) {
    Send(RtpsBytes(writer).Sample(writer, 2, payload), kVictim);
  }
  EXPECT_THAT(Step(), ElementsAre(Field(&Finding::kind, "two_contents")));
}

TEST_F(ForgedTrafficTest, AnHonestWriterIsNoFinding) {
  int64_t number = 0;
  for (int step = 0; step < 100; ++step) {
    for (int i = 0; i < 10; ++i) {
      const std::string payload = absl::StrCat("twist ", ++number);
      for (const Locator& to : {kSensor, kVictim}) Send(Sample(number, payload), to);
      watch_->Received(kWriter, static_cast<uint64_t>(number));
    }
    Send(RtpsBytes(TestGuid(1, 0)).Heartbeat(kWriter, number, number), kVictim);
    // What the other one lost comes again, with other headers.
    Send(RtpsBytes(TestGuid(1, 0)).Sample(kWriter, number - 3, absl::StrCat("twist ", number - 3)),
         kVictim);
    EXPECT_THAT(Step(), IsEmpty());
  }
  // It has no reader for an hour, and then one again.
  now_ns_ += 3'600 * kNanosPerSecond;
  number += 100'000'000;
  Send(Sample(number), kSensor);
  EXPECT_THAT(Step(), IsEmpty());
  EXPECT_THAT(jumps_, IsEmpty());
}

TEST_F(ForgedTrafficTest, JumpsThatNobodyTakesAreBounded) {
  for (int i = 0; i < 1'000; ++i) {
    Send(Sample(1), kSensor);
    Send(Sample(kFar), kSensor);
    TapReport report{.domain = 42, .traffic = table_.Take()};
    watch_->Take(report, now_ns_);
  }
  EXPECT_LE(watch_->TakeJumps().size(), 256);
  EXPECT_GT(watch_->counters().findings_dropped, 0);
}

}  // namespace
}  // namespace rips::wire
