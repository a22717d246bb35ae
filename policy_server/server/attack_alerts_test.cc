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
#include "services/rpc/call_gate.h"

namespace rips {
namespace {

using ::testing::AllOf;
using ::testing::Each;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;
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
  void Refuse(const std::string& viewer, absl::string_view reason) {
    attacks_.OnCallRefused({.role = rpc::Role::kOperator,
                            .trust_domain = "td",
                            .operator_role = rpc::OperatorRole::kViewer,
                            .name = viewer},
                           reason, "ipv4:10.0.0.7:4711");
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
  std::vector<std::string> misused_;
  AttackAlerts attacks_{&alerts_, &clock_, [this](const auto& agent, const std::string& peer) {
                          misused_.push_back(absl::StrCat(rpc::ToString(agent), " ", peer));
                        }};
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
                  HasSubstr(", whose peer was not known yet, sent bytes of which nothing came"),
                  HasSubstr("began calls without end")));
}

TEST_F(AttackAlertsTest, TheRobotIsToldOfItsAgentsKeyOnceInFiveSeconds) {
  const rpc::PeerIdentity sensor{
      .role = rpc::Role::kSensor, .trust_domain = "td", .robot = "r1", .host = "base"};
  const auto refuse = [&](absl::string_view reason) {
    attacks_.OnCallRefused(sensor, reason, "ipv4:10.0.0.66:1");
  };
  for (const char* reason : {"expired", "revoked", "banned", "limit", "undecodable"}) {
    refuse(reason);
  }
  EXPECT_THAT(misused_, IsEmpty()) << "by its owner, perhaps";
  attacks_.OnConnectionEnded({.peer = "ipv4:10.0.0.66:4711",
                              .certificate = "spiffe://td/robot/r1/sensor/base serial 01",
                              .identity = sensor,
                              .excess = rpc::Excess::kRefused});
  refuse("throttled");
  EXPECT_THAT(misused_, ElementsAre("spiffe://td/robot/r1/sensor/base ipv4:10.0.0.66:4711"));
  for (const char* reason : {"throttled", "claim", "role"}) {
    clock_.Advance(AttackAlerts::kMisuseEveryNs);
    refuse(reason);
    refuse(reason);
  }
  EXPECT_THAT(misused_, SizeIs(4));
  End(kMallory);
  Refuse("mallory", "throttled");
  EXPECT_THAT(misused_, SizeIs(4)) << "no agent's";
  EXPECT_THAT(Told(), SizeIs(2)) << "as of any certificate";
}

TEST_F(AttackAlertsTest, AConnectionThatOnlyKeepsSilentIsNoAttack) {
  End("", rpc::Excess::kSilent, 0);
  EXPECT_THAT(Told(), IsEmpty());
}

TEST_F(AttackAlertsTest, WhereNothingIsBannedItIsToldAllTheSame) {
  End("", rpc::Excess::kBytes, 0);
  EXPECT_THAT(Told(), ElementsAre(HasSubstr("it was ended, and nothing banned, since ours connect "
                                            "from that address, too")));
}

TEST_F(AttackAlertsTest, AFloodNamesItsAddressAtOnceAndCountsItEachMinute) {
  attacks_.Poll();
  for (int i = 0; i < 1'000; ++i) attacks_.OnConnectionWasted("10.0.0.7", false);
  for (int i = 0; i < 10; ++i) attacks_.OnConnectionWasted("10.0.0.8", false);
  for (int i = 0; i < 3; ++i) {
    clock_.Advance(60 * kNanosPerSecond);
    attacks_.Poll();
  }
  EXPECT_THAT(Told(),
              ElementsAre(AllOf(StartsWith("(server) high a flood of connections from 10.0.0.7: "
                                           "64 within 1 s made no call. Robots that are connected "
                                           "are guarded as before"),
                                HasSubstr("if none is to, a firewall can shut the address out")),
                          HasSubstr("1010 without a call in the last minute, from 2 addresses, "
                                    "most from 10.0.0.7 (1000), 10.0.0.8 (10); below the limit "
                                    "in the last 10 s"),
                          StartsWith("(server) info the flood of connections is over: 0 without a "
                                     "call in the last minute")));
}

TEST_F(AttackAlertsTest, AFloodFromWhereAgentsAreSaysThatAFirewallWouldShutThemOut) {
  for (int i = 0; i < 64; ++i) attacks_.OnConnectionWasted("10.0.0.7", i == 3);
  EXPECT_THAT(Told(), ElementsAre(HasSubstr("a firewall would shut them out, too")));
}

TEST_F(AttackAlertsTest, DecoysDoNotHideHowManyThereAre) {
  for (int minute = 0; minute < 30; ++minute) {
    for (int i = 0; i < 40 * 64; ++i) {
      attacks_.OnConnectionWasted(absl::StrCat("10.0.", minute, ".", i % 40), false);
    }
    clock_.Advance(60 * kNanosPerSecond);
    attacks_.Poll();
  }
  int minutes = 0;
  for (const std::string& text : Told()) {
    EXPECT_THAT(text, Not(HasSubstr("more alerts")));
    minutes += absl::StrContains(text, "2560 without a call in the last minute, from 40 addresses")
                   ? 1
                   : 0;
  }
  EXPECT_GE(minutes, 29);
}

// Severity and rate are those without it.
TEST_F(AttackAlertsTest, AlertsOfARobotInMaintenanceCarryItsMark) {
  const store::Maintenance reboot{.until_unix_ns = clock_.Now().unix_ns + 90 * kNanosPerSecond,
                                  .by = "carol (x)",
                                  .reason = "reboot"};
  alerts_.SetMaintenance("r1", reboot);
  alerts_.SetMaintenance("r2", reboot);
  alerts_.SetMaintenance("r2", std::nullopt);
  for (int i = 0; i < 3; ++i) {
    attacks_.OnPeerRefused("r1");
    attacks_.OnPeerRefused("r2");
    clock_.Advance(60 * kNanosPerSecond);
  }
  EXPECT_THAT(Told(), Each(HasSubstr(" high peers of robot r")));
  std::vector<std::string> marks;
  const auto page = store_.AlertsAfter("", 0, 0);
  for (const store::AlertRecord& alert : page->alerts) marks.push_back(alert.maintenance);
  const std::string mark = "in maintenance until 2026-01-01 00:01:30 UTC (asked by carol: reboot)";
  EXPECT_THAT(marks, ElementsAre(mark, "", mark, "", "", ""));
}

TEST_F(AttackAlertsTest, ARobotsPeersAreToldOfThatRobot) {
  attacks_.OnPeerRefused("r1");
  attacks_.OnPeerRefused("r1");
  attacks_.OnPeerRefused("r2");
  EXPECT_THAT(Told(), ElementsAre(StartsWith("r1 high peers of robot r1 send more"),
                                  StartsWith("r2 high peers of robot r2 send more")));
}

TEST_F(AttackAlertsTest, ARefusedCallIsNothingButManyNameTheCaller) {
  for (int i = 0; i < 19; ++i) Refuse("script", "role");
  for (int i = 0; i < 100; ++i) Refuse("mallory", i == 5 ? "role" : "quota");
  EXPECT_THAT(
      Told(),
      ElementsAre(AllOf(StartsWith(absl::StrCat("(server) high 20 calls of ", kMallory,
                                                " were refused within 1 s, last from "
                                                "ipv4:10.0.0.7:4711; in this minute: its role does "
                                                "not allow what it asks (1), it asks more than "
                                                "its quota allows (19). None had an effect")),
                        HasSubstr(absl::StrCat("ripsctl agent ban ", kMallory)))));
}

TEST_F(AttackAlertsTest, EachReasonToRefuseACallHasAText) {
  for (const absl::string_view reason : rpc::kRefusalReasons) {
    if (reason == "unidentified") continue;  // it has no certificate
    for (int i = 0; i < 20; ++i) Refuse(std::string(reason), reason);
  }
  EXPECT_THAT(Told(), AllOf(SizeIs(std::size(rpc::kRefusalReasons) - 1),
                            Each(Not(HasSubstr("for a reason of its own")))));
}

TEST_F(AttackAlertsTest, WhoIsShutOutAlreadyNeedsNoBan) {
  for (int i = 0; i < 20; ++i) Refuse("mallory", "banned");
  EXPECT_THAT(Told(), ElementsAre(AllOf(HasSubstr("it is banned (20). None had an effect"),
                                        Not(HasSubstr("agent ban")))));
}

// As long as they go on, and from however many certificates.
TEST_F(AttackAlertsTest, ManyRefusedCertificatesHideNoOther) {
  for (int round = 0; round < 60; ++round) {
    for (int agent = 0; agent < 12; ++agent) {
      for (int i = 0; i < 25; ++i) {
        attacks_.OnCallRefused({.role = rpc::Role::kSensor,
                                .trust_domain = "td",
                                .robot = absl::StrCat("r", agent),
                                .host = "base"},
                               "role", "ipv4:10.0.0.9:1");
      }
    }
    clock_.Advance(9 * kNanosPerSecond);
    attacks_.Poll();
  }
  for (int i = 0; i < 25; ++i) Refuse("mallory", "role");
  int named = 0;
  for (const std::string& text : Told()) {
    named += absl::StrContains(text, absl::StrCat("20 calls of ", kMallory)) ? 1 : 0;
  }
  EXPECT_EQ(named, 1);
}

}  // namespace
}  // namespace rips
