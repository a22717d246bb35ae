// The whole sensor with a tap that is played by the test.
#include "sensor_agent/wire/wire_input.h"

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <iterator>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/agent.h"
#include "sensor_agent/fake_robot.h"
#include "sensor_agent/outbox/sensor_status.h"
#include "sensor_agent/uplink/fake_policy_server.h"
#include "sensor_agent/wire/report_sender.h"
#include "sensor_agent/wire/rtps_bytes.h"
#include "services/base/status_matchers.h"
#include "services/model/finding_digest.h"
#include "services/rpc/credentials.h"
#include "services/rpc/test_pki.h"
#include "services/runtime/real_clock.h"

namespace rips::sensor {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::IsSupersetOf;
using ::testing::Not;

constexpr char kOver[] = " over";

class WireInputTest : public testing::Test {
 protected:
  WireInputTest() {
    std::string name = (std::filesystem::temp_directory_path() / "wire_input.XXXXXX").string();
    dir_ = mkdtemp(name.data());
    path_ = absl::StrCat(dir_, "/wire.sock");
    tap_.emplace(path_);
    const auto server = rpc::Credentials::Load(pki_.Server());
    EXPECT_THAT(server, IsOk());
    server_.Start((*server)->ForServer());
  }
  ~WireInputTest() override {
    if (agent_ != nullptr) agent_->Stop();
    server_.Stop();
    EXPECT_THAT(server_.violations, IsEmpty());
    std::filesystem::remove_all(dir_);
  }

  void StartAgent() {
    const auto sensor = rpc::Credentials::Load(pki_.Sensor());
    ASSERT_THAT(sensor, IsOk());
    auto agent = Agent::Create({.robot = "r1",
                                .host = "base",
                                .servers = {server_.address()},
                                .dds = {.domain = dds::RandomDomain(), .interface = "lo"},
                                .watch = {.settle = absl::Milliseconds(200)},
                                .wire = true,
                                .wire_socket = path_},
                               (*sensor)->ForClient(), &clock_, &metrics_);
    ASSERT_THAT(agent, IsOk());
    agent_ = *std::move(agent);
    agent_->Start();
  }
  // One datagram of `writer` to everybody in our domain. `conflict_size` not 0: with a second
  // content of so many bytes.
  void Report(const ros2::Guid& writer, uint64_t sequence = 1, uint32_t conflict_size = 0) {
    const int64_t now_ns = clock_.Now().boottime_ns;
    if (!tap_->Ready(now_ns)) return;
    const uint8_t loopback[] = {127, 0, 0, 1};
    const uint8_t everybody[] = {239, 255, 0, 1};
    const auto port = static_cast<uint16_t>(7'400 + 250 * dds::RandomDomain() + 1);
    ++packets_;
    wire::Traffic traffic = {.writer = writer,
                             .source = {wire::FromV4(loopback), 40'001},
                             .vendor = 0x0110,
                             .packets = 1,
                             .data = 1,
                             .data_last = sequence,
                             .first_packet = packets_,
                             .last_packet = packets_,
                             .destinations = {{{wire::FromV4(everybody), port}, 1}},
                             .data_least = sequence,
                             .conflicts = conflict_size == 0 ? 0u : 1u,
                             .conflict_number = sequence,
                             .conflict_size = conflict_size};
    traffic.numbers.Add(sequence);
    tap_->Send({.domain = dds::RandomDomain(),
                .boottime_ns = now_ns,
                .counters = {.packets = packets_},
                .local_addresses = {wire::FromV4(loopback)},
                .traffic = {traffic}},
               now_ns);
  }
  // "unicast_writer GUID", with kOver.
  static std::vector<std::string> Findings(const FakePolicyServer& server) {
    std::vector<std::string> findings;
    for (const Recorded& each : server.received) {
      if (!each.what.has_finding()) continue;
      const rips::v1::Finding& finding = each.what.finding();
      const auto guid = ros2::GuidFromBytes(finding.guid());
      findings.push_back(absl::StrCat(finding.kind(), " ", guid.ok() ? ToString(*guid) : "none",
                                      finding.over() ? kOver : ""));
    }
    return findings;
  }
  static std::vector<std::string> NotVisible(const FakePolicyServer& server) {
    std::vector<std::string> kinds;
    for (const auto& hello : server.hellos) {
      kinds.assign(hello.not_visible().begin(), hello.not_visible().end());
    }
    for (const Recorded& each : server.received) {
      if (!each.what.has_state()) continue;
      kinds.assign(each.what.state().not_visible().begin(), each.what.state().not_visible().end());
    }
    return kinds;
  }

  rpc::TestPki pki_;
  const RealClock clock_;
  Metrics metrics_;
  std::string dir_;
  std::string path_;
  FakeRobot robot_;
  FakePolicyServer server_;
  std::unique_ptr<Agent> agent_;
  std::optional<wire::ReportSender> tap_;
  uint64_t packets_ = 0;
};

TEST_F(WireInputTest, TellsWhatDiscoveryDoesNotShow) {
  auto talker = robot_.AddProcess();
  const ros2::Guid known = talker->AddWriter("rt/chatter").guid();
  const ros2::Guid hidden = wire::TestGuid(9, 0x103);
  StartAgent();

  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    Report(known);
    Report(hidden);
    return !Findings(s).empty();
  }));

  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    EXPECT_THAT(Findings(s), ElementsAre(absl::StrCat("unicast_writer ", ToString(hidden))));
    return true;
  }));
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    std::optional<uint64_t> told;
    uint64_t said = 0;
    for (const Recorded& each : s.received) {
      if (each.what.has_state()) {
        said = each.what.state().findings_digest();
        EXPECT_FALSE(each.what.state().findings_all_told()) << "in its first minute";
      }
      if (!each.what.has_finding()) continue;
      const rips::v1::Finding& finding = each.what.finding();
      told = model::DigestOf({.kind = finding.kind(),
                              .guid = *ros2::GuidFromBytes(finding.guid()),
                              .node = finding.node(),
                              .topic = finding.topic()});
    }
    return told == said;
  }));
}

TEST_F(WireInputTest, WhatOthersGotInPlaceOfAMessageIsOneThatCannotBeInspected) {
  auto talker = robot_.AddProcess();
  const ros2::Guid writer = talker->AddWriter("rt/chatter").guid();
  StartAgent();
  static constexpr uint32_t kBytes = 4'711;

  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    Report(writer, 1, kBytes);
    return testing::Matches(Contains(absl::StrCat("two_contents ", ToString(writer))))(Findings(s));
  }));

  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    Report(writer, 1, kBytes);
    return std::any_of(s.received.begin(), s.received.end(), [](const Recorded& each) {
      if (!each.what.has_message()) return false;
      const rips::v1::MessageSeen& message = each.what.message();
      return message.size_bytes() == kBytes && message.truncated() && message.payload().empty();
    });
  }));
  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    return std::any_of(s.received.begin(), s.received.end(), [](const Recorded& each) {
      return each.what.has_state() && each.what.state().blind_size() == 1 &&
             each.what.state().blind(0) ==
                 "wire tap: a writer sends others what does not come to the sensor";
    });
  }));
}

TEST_F(WireInputTest, AJumpIsAFindingOfItsWriter) {
  auto talker = robot_.AddProcess();
  const ros2::Guid writer = talker->AddWriter("rt/chatter").guid();
  StartAgent();
  uint64_t number = 1;

  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    Report(writer, number);
    number = number == 1 ? uint64_t{1} << 40 : 1;
    return testing::Matches(Contains(absl::StrCat("sequence_jump ", ToString(writer))))(
        Findings(s));
  }));
}

TEST_F(WireInputTest, FindingsOfATapThatHasJustComeAreNotAll) {
  const auto input = wire::WireInput::Create(
      {.socket = path_, .domain = dds::RandomDomain()}, [] {}, &metrics_);
  ASSERT_THAT(input, IsOk());
  constexpr int64_t kStartNs = 100 * kNanosPerSecond;
  constexpr int64_t kSettledNs = kStartNs + wire::WireInput::kTapSettleNs;
  EXPECT_TRUE((*input)->ToldAll(kStartNs)) << "without a tap it is blind, or not asked for";
  GraphBuilder graph({}, kStartNs);
  const absl::Time deadline = absl::Now() + absl::Seconds(30);
  while ((*input)->ToldAll(kStartNs) && absl::Now() < deadline) {
    tap_->Ready(clock_.Now().boottime_ns);
    (*input)->Poll(graph, kStartNs);
    absl::SleepFor(absl::Milliseconds(20));
  }
  EXPECT_FALSE((*input)->ToldAll(kSettledNs - 1));
  EXPECT_TRUE((*input)->ToldAll(kSettledNs));
}

TEST_F(WireInputTest, SaysWhetherItSeesWhatOnlyATapSees) {
  const std::vector<std::string> kinds(std::begin(kSeenByTap), std::end(kSeenByTap));
  ASSERT_EQ(kinds.size(), 4u);
  StartAgent();
  ASSERT_TRUE(server_.WaitUntil([](const FakePolicyServer& s) { return !s.hellos.empty(); }));
  const auto none_is_visible = [&](const FakePolicyServer& s) {
    return testing::Matches(IsSupersetOf(kinds))(NotVisible(s));
  };
  EXPECT_TRUE(server_.WaitUntil(none_is_visible));

  EXPECT_TRUE(server_.WaitUntil([&](const FakePolicyServer& s) {
    Report(wire::TestGuid(9, 0x103));
    return testing::Matches(Not(Contains(testing::AnyOfArray(kinds))))(NotVisible(s));
  }));

  // The tap hangs: connected, and silent.
  EXPECT_TRUE(server_.WaitUntil(none_is_visible));
}

TEST_F(WireInputTest, ATapThatStaysAwayIsAReasonToBeBlind) {
  const auto input = wire::WireInput::Create(
      {.socket = path_, .domain = 7}, [] {}, &metrics_);
  ASSERT_THAT(input, IsOk());
  constexpr int64_t kStartNs = 100 * kNanosPerSecond;
  const int64_t end_ns = kStartNs + wire::WireInput::kAwayNs;
  EXPECT_THAT((*input)->Blind(kStartNs), IsEmpty());
  EXPECT_THAT((*input)->Blind(end_ns - 1), IsEmpty()) << "the tap may be starting";
  EXPECT_THAT((*input)->Blind(end_ns),
              ElementsAre(absl::StrCat("wire tap: no rips-wire reports at `", path_, "`")));
}

TEST_F(WireInputTest, DoesNotStartWithoutItsSocket) {
  std::filesystem::remove_all(dir_);
  const auto sensor = rpc::Credentials::Load(pki_.Sensor());
  ASSERT_THAT(sensor, IsOk());
  const auto agent = Agent::Create({.robot = "r1",
                                    .host = "base",
                                    .servers = {server_.address()},
                                    .dds = {.domain = dds::RandomDomain(), .interface = "lo"},
                                    .wire = true,
                                    .wire_socket = path_},
                                   (*sensor)->ForClient(), &clock_, &metrics_);

  EXPECT_THAT(agent.status(), StatusIs(absl::StatusCode::kNotFound, HasSubstr(path_)));
}

}  // namespace
}  // namespace rips::sensor
