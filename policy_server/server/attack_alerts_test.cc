#include "policy_server/server/attack_alerts.h"

#include <atomic>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/robot/fake_ports.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/fake_store.h"
#include "services/base/fake_clock.h"

namespace rips {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::StartsWith;

constexpr char kMallory[] = "spiffe://td/operator/viewer/mallory";

class AttackAlertsTest : public ::testing::Test {
 protected:
  void End(const std::string& certificate, rpc::Excess excess = rpc::Excess::kBytes,
           int64_t banned_ns = 10 * kNanosPerSecond) {
    attacks_.OnConnectionEnded({.peer = "ipv4:10.0.0.7:4711",
                                .certificate = certificate,
                                .excess = excess,
                                .banned_ns = banned_ns});
  }
  // All that was told: robot, severity, text.
  std::vector<std::string> Told() {
    committer_.Stop();
    std::vector<std::string> texts;
    const auto page = store_.AlertsAfter("", 0, 0);
    for (const store::AlertRecord& alert : page->alerts) {
      texts.push_back(absl::StrCat(alert.robot, " ", alert.severity, " ", alert.text));
    }
    return texts;
  }

  FakeClock clock_;
  store::FakeStore store_;
  store::Committer committer_{&store_, {}, &clock_};
  pipeline::FakeObserver audience_;
  std::atomic<int> ids_ = 0;
  pipeline::ServerAlerts alerts_{&committer_, &audience_, &clock_,
                                 [this] { return absl::StrFormat("%032x", ++ids_); }};
  AttackAlerts attacks_{&alerts_, &clock_};
};

TEST_F(AttackAlertsTest, EachCertificateIsToldOnceAMinuteAndAllWithoutOneTogether) {
  for (int i = 0; i < 3; ++i) {
    End(kMallory);
    End("");
  }
  clock_.Advance(60 * kNanosPerSecond);
  End(kMallory, rpc::Excess::kCalls);
  EXPECT_THAT(
      Told(),
      ElementsAre(AllOf(StartsWith("(server) critical the server is attacked: a connection from "
                                   "ipv4:10.0.0.7:4711"),
                        HasSubstr(kMallory), HasSubstr("banned for 10 s")),
                  HasSubstr("without a certificate of ours sent bytes of which nothing came"),
                  HasSubstr("began calls without end")));
}

TEST_F(AttackAlertsTest, AConnectionThatIsNotBannedIsNoAttack) {
  End("", rpc::Excess::kSilent, 0);
  EXPECT_THAT(Told(), IsEmpty());
}

TEST_F(AttackAlertsTest, AFloodNamesItsAddressOrHowManyThereAre) {
  attacks_.OnFlood({.source = "10.0.0.7", .refused = 64, .within_ns = kNanosPerSecond / 2});
  attacks_.OnFlood(
      {.source = "10.0.0.8", .of_source = 40, .sources = 90, .refused = 512, .within_ns = 1});
  EXPECT_THAT(Told(),
              ElementsAre(AllOf(StartsWith("(server) high a flood of connections: 64 from 10.0.0.7 "
                                           "within 1 s made no call. What is connected stays"),
                                Not(HasSubstr("Agents of ours"))),
                          HasSubstr("512 from 90 addresses, within 1 s made no call; the most (40) "
                                    "from 10.0.0.8.")));
}

TEST_F(AttackAlertsTest, AFloodFromWhereAgentsAreSaysThatItMayBeOneOfThem) {
  attacks_.OnFlood({.source = "10.0.0.7", .refused = 64, .known = true});
  EXPECT_THAT(Told(), ElementsAre(HasSubstr("Agents of ours have connected from there")));
}

TEST_F(AttackAlertsTest, DecoysDoNotHideHowManyThereAre) {
  rpc::FloodWatch watch({});
  const int64_t half_hour_ns = 1'800 * kNanosPerSecond;
  int totals = 0;
  for (int64_t at_ns = half_hour_ns; at_ns < 2 * half_hour_ns; at_ns += 10 * kNanosPerSecond) {
    for (int i = 0; i < 40 * 64; ++i) {
      const auto flood = watch.Count(absl::StrCat("10.0.0.", i % 40), at_ns);
      if (!flood) continue;
      attacks_.OnFlood(*flood);
      totals += flood->sources > 1 ? 1 : 0;
    }
    clock_.Advance(10 * kNanosPerSecond);
  }
  EXPECT_EQ(totals, 30);
  int told = 0;
  for (const std::string& text : Told()) {
    EXPECT_THAT(text, Not(HasSubstr("more alerts")));
    told += absl::StrContains(text, " addresses") ? 1 : 0;
  }
  EXPECT_EQ(told, 30);
}

TEST_F(AttackAlertsTest, ARobotsPeersAreToldOfThatRobot) {
  attacks_.OnPeerRefused("r1");
  attacks_.OnPeerRefused("r1");
  attacks_.OnPeerRefused("r2");
  EXPECT_THAT(Told(), ElementsAre(StartsWith("r1 high peers of robot r1 send more"),
                                  StartsWith("r2 high peers of robot r2 send more")));
}

TEST_F(AttackAlertsTest, ARefusedCallIsNothingButManyNameTheCaller) {
  for (int i = 0; i < 19; ++i) attacks_.OnCallRefused("spiffe://td/operator/viewer/script", "role");
  for (int i = 0; i < 100; ++i) attacks_.OnCallRefused(kMallory, i % 2 == 0 ? "role" : "quota");
  EXPECT_THAT(Told(), ElementsAre(AllOf(
                          StartsWith(absl::StrCat("(server) high 20 calls of ", kMallory,
                                                  " were refused within 1 s, the last because it "
                                                  "asks more than its quota allows. ")),
                          HasSubstr(absl::StrCat("ripsctl agent ban ", kMallory)))));
}

}  // namespace
}  // namespace rips
