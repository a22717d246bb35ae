// The firewall on the kernel's own packet filter, in a network namespace of this test's thread:
// the host is not touched, and nothing is left behind.
#include "mode_actuator/helpers/fw/firewall.h"

#include <fcntl.h>
#include <sched.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <map>
#include <thread>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/time/clock.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "mode_actuator/helpers/fw/fw_server.h"
#include "mode_actuator/helpers/fw/nft_runner.h"
#include "mode_actuator/steps/firewall/fw_client.h"
#include "nlohmann/json.hpp"
#include "services/base/fake_clock.h"
#include "services/base/status_matchers.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/cancel_flag.h"
#include "services/runtime/unique_fd.h"

namespace rips::actuator {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Pair;
using ::testing::SizeIs;
using ::testing::UnorderedElementsAre;
using Kind = FirewallStep::Kind;

constexpr absl::string_view kFragment = R"(chain input {
  udp dport 7400-7500 ip saddr != { 10.0.0.0/24, 10.9.0.1 } limit rate 10/second counter drop
  ct state established,related accept
}
chain output {
  ip daddr 10.7.0.0/16 drop
}
)";

class FakeHost : public HostView {
 public:
  absl::StatusOr<std::vector<ControlAddress>> Control() override {
    if (!status.ok()) return status;
    return control;
  }
  absl::StatusOr<KeptOpen> Kept() override { return kept; }

  absl::Status status;
  std::vector<ControlAddress> control = {{TargetKind::kIpv4, "10.0.0.1", 7443},
                                         {TargetKind::kIpv6, "fd00::1", 7443}};
  KeptOpen kept = {
      .servers = {"10.0.0.1", "fd00::1"}, .own = {"10.0.0.2"}, .gateways = {"10.0.0.3"}};
};

class FirewallTest : public ::testing::Test {
 protected:
  void SetUp() override {
    if (geteuid() != 0) GTEST_SKIP() << "making a network namespace needs root";
    ASSERT_EQ(access("/usr/sbin/nft", X_OK), 0) << "no nft: run ./deploy/install-packages";
    outside_ = UniqueFd(open("/proc/thread-self/ns/net", O_RDONLY | O_CLOEXEC));
    ASSERT_EQ(unshare(CLONE_NEWNET), 0) << std::strerror(errno);
    char name[] = "/tmp/rips-firewall-XXXXXX";
    directory_ = mkdtemp(name);
    file_ = directory_ + "/alert.nft";
    other_ = directory_ + "/other.nft";
    ASSERT_THAT(WriteFileAtomically(file_, kFragment), IsOk());
    ASSERT_THAT(WriteFileAtomically(other_, "chain input {\n  tcp dport 22 drop\n}\n"), IsOk());
    Restart();
  }
  void TearDown() override {
    if (outside_.get() < 0) return;
    EXPECT_EQ(setns(outside_.get(), CLONE_NEWNET), 0);
    for (const std::string& path : {file_, other_}) unlink(path.c_str());
    rmdir(directory_.c_str());
  }

  // As after the death of rips-fw.
  void Restart(absl::Duration hold = absl::Seconds(12)) {
    firewall_ = std::make_unique<Firewall>(FirewallOptions{.files = {file_, other_}, .hold = hold},
                                           &nft_, &host_, &clock_);
  }
  FirewallStep Rules(absl::Duration hold_for = absl::Minutes(10)) const {
    return {.kind = Kind::kRules, .file = file_, .hold_for = hold_for};
  }
  static FirewallStep Hosts(std::vector<std::string> targets,
                            absl::Duration hold_for = absl::Minutes(10)) {
    return {.kind = Kind::kIsolateHosts, .targets = std::move(targets), .hold_for = hold_for};
  }
  FwResponse Enter(const FirewallStep& step) { return firewall_->Handle({FwVerb::kEnter, step}); }
  FwResponse Check(const FirewallStep& step) { return firewall_->Handle({FwVerb::kCheck, step}); }
  FwResponse Try(const FirewallStep& step) { return firewall_->Handle({FwVerb::kTry, step}); }
  FwResponse Release() { return Enter({.kind = Kind::kRelease}); }

  // What somebody else does.
  void Admin(absl::string_view script) {
    ASSERT_THAT(nft_.Load(script, NftMode::kCommit), IsOk()) << script;
  }
  Ruleset Now() {
    const absl::StatusOr<std::string> json = nft_.ListTable();
    if (!json.ok()) return {};
    return ParseRuleset(*json).value_or(Ruleset{});
  }

  UniqueFd outside_;
  std::string directory_, file_, other_;
  NftRunner nft_{{.timeout = absl::Seconds(60)}};
  FakeHost host_;
  FakeClock clock_;
  std::unique_ptr<Firewall> firewall_;
};

TEST_F(FirewallTest, LoadsTheRulesOfALevelAndReadsThemBack) {
  ASSERT_THAT(firewall_->CheckFiles(), IsOk());
  EXPECT_FALSE(Now().present) << "a dry run has loaded something";
  const FwResponse response = Enter(Rules());
  ASSERT_THAT(response.status, IsOk());
  EXPECT_EQ(response.observed, "firewall=alert.nft");
  EXPECT_THAT(Check(Rules()).status, IsOk());

  const Ruleset now = Now();
  EXPECT_THAT(now.chains.at("level_in").comments, ElementsAre("rips 1", "rips 2"));
  EXPECT_THAT(now.chains.at("level_out").comments, ElementsAre("rips 3"));
  EXPECT_THAT(now.sets.at("level_hold"), SizeIs(2));
  EXPECT_THAT(now.sets.at("control4"), ElementsAre(SetElement{"10.0.0.1 . 7443"}));
  EXPECT_THAT(now.sets.at("control6"), ElementsAre(SetElement{"fd00::1 . 7443"}));
  for (const char* chain : {"input", "output", "forward"}) {
    EXPECT_EQ(now.chains.at(chain).base, absl::StrCat("filter ", chain, " -150 accept"));
    // The servers before anything that drops, the level last.
    const std::vector<std::string>& rules = now.chains.at(chain).rules;
    size_t control = 0, drop = rules.size();
    for (size_t i = 0; i < rules.size(); ++i) {
      if (rules[i].find("@control") != std::string::npos) control = i;
      if (rules[i].find("drop") != std::string::npos) drop = std::min(drop, i);
    }
    EXPECT_LT(control, drop) << chain;
    EXPECT_THAT(rules.back(), HasSubstr("\"jump\""));
    EXPECT_THAT(rules.back(), HasSubstr("@level_hold"));
  }
}

TEST_F(FirewallTest, CountsWhatIsDroppedOnItsWayIn) {
  ASSERT_THAT(WriteFileAtomically(other_, R"(chain input {
  tcp dport 22 counter drop
  tcp dport 23 reject with tcp reset
  udp dport 9 reject
  ct state established accept
  drop
}
chain forward {
  ip saddr 10.0.0.7 drop
}
chain output {
  ip daddr 10.0.0.7 drop
}
)"),
              IsOk());
  FirewallStep rules = Rules();
  rules.file = other_;
  ASSERT_THAT(Enter(rules).status, IsOk());
  const nlohmann::json table = nlohmann::json::parse(nft_.ListTable().value_or(""));
  // By chain: how many rules count.
  std::map<std::string, int> counting;
  for (const auto& entry : table["nftables"]) {
    if (!entry.contains("rule")) continue;
    for (const auto& each : entry["rule"]["expr"]) {
      if (each.contains("counter") && each["counter"] == "dropped") {
        ++counting[entry["rule"]["chain"]];
      }
    }
  }
  // The table's own: a participant; hosts by IPv4, IPv6 and MAC, where they come from.
  EXPECT_THAT(counting,
              UnorderedElementsAre(Pair("level_in", 4), Pair("level_forward", 1), Pair("input", 4),
                                   Pair("forward", 4), Pair("output", 1)));
  EXPECT_EQ(Check(rules).dropped, 0u);
  EXPECT_EQ(Check({.kind = Kind::kRelease}).dropped, std::nullopt);
}

TEST_F(FirewallTest, LoadingTwiceGivesTheSameRulesetAndKeepsTimers) {
  ASSERT_THAT(Enter(Hosts({"10.0.0.7", "fd00::7", "02:00:5e:00:53:01"})).status, IsOk());
  ASSERT_THAT(
      Enter({.kind = Kind::kIsolateParticipants, .targets = {"00104a3b0000000000000001"}}).status,
      IsOk());
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  const Ruleset once = Now();
  clock_.Advance(30 * kNanosPerSecond);
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  ASSERT_THAT(Enter(Hosts({"10.0.0.7", "fd00::7"}, absl::Seconds(20))).status, IsOk());
  const Ruleset twice = Now();
  EXPECT_EQ(once.chains, twice.chains);
  for (const char* set : {"quarantine4", "quarantine6", "quarantine_mac", "bad_guid"}) {
    ASSERT_THAT(twice.sets.at(set), SizeIs(1)) << set;
    EXPECT_EQ(twice.sets.at(set)[0].since_s, 1000) << "forgot when it began";
    EXPECT_GT(twice.sets.at(set)[0].expires_s, 400) << "an isolation was shortened";
  }
  EXPECT_EQ(twice.sets.at("bad_guid")[0].value, "00104a3b0000000000000001");
}

TEST_F(FirewallTest, TheShippedFileIsTakenByTheKernel) {
  const auto text = ReadFile(RIPS_SOURCE_DIR "/deploy/config/alert.nft", kFragmentBytesMax);
  ASSERT_THAT(text, IsOk());
  ASSERT_THAT(WriteFileAtomically(file_, *text), IsOk());
  EXPECT_THAT(Enter(Rules()).status, IsOk());
}

TEST_F(FirewallTest, OnlyFilesOfTheConfigurationAreLoaded) {
  FirewallStep step = Rules();
  step.file = "/etc/passwd";
  EXPECT_THAT(Enter(step).status, StatusIs(absl::StatusCode::kPermissionDenied,
                                           HasSubstr("`/etc/passwd` is in no step")));
  EXPECT_FALSE(Now().present);
}

TEST_F(FirewallTest, AFileThatBecameBadChangesNothing) {
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  const Ruleset before = Now();
  ASSERT_THAT(WriteFileAtomically(other_, "chain input {\n drop\n frobnicate\n}\n"), IsOk());
  FirewallStep step = Rules();
  step.file = other_;
  EXPECT_THAT(Enter(step).status,
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("syntax error")));
  EXPECT_EQ(Now().chains, before.chains);
  EXPECT_THAT(firewall_->CheckFiles(), StatusIs(absl::StatusCode::kInvalidArgument,
                                                HasSubstr(absl::StrCat("`", other_, "`: "))));
  // What nft understands and the kernel does not have.
  ASSERT_THAT(WriteFileAtomically(other_, "chain input {\n dnat ip to 10.0.0.9\n}\n"), IsOk());
  EXPECT_THAT(firewall_->CheckFiles(), StatusIs(absl::StatusCode::kInvalidArgument));
  ASSERT_EQ(chmod(other_.c_str(), 0666), 0);
  EXPECT_THAT(Enter(step).status, StatusIs(absl::StatusCode::kPermissionDenied));
}

TEST_F(FirewallTest, NeverIsolatesServersItselfOrTheGateway) {
  const std::pair<const char*, const char*> kCases[] = {{"10.0.0.1", "a policy server"},
                                                        {"fd00::1", "a policy server"},
                                                        {"10.0.0.2", "this host itself"},
                                                        {"10.0.0.3", "the gateway"},
                                                        {"127.0.0.1", "a loopback address"}};
  for (const auto& [target, why] : kCases) {
    EXPECT_THAT(Enter(Hosts({"10.0.0.7", target})).status,
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(why)));
  }
  EXPECT_FALSE(Now().present) << "the other target was isolated all the same";
}

TEST_F(FirewallTest, WithoutAKnownServerNothingIsCut) {
  host_.status = absl::UnavailableError("the address of server `x:1` is not known");
  EXPECT_THAT(Enter(Rules()).status, StatusIs(absl::StatusCode::kUnavailable));
  EXPECT_THAT(Enter(Hosts({"10.0.0.7"})).status, StatusIs(absl::StatusCode::kUnavailable));
  EXPECT_FALSE(Now().present);
}

TEST_F(FirewallTest, TellsWhatSomebodyElseChangedAndMendsIt) {
  const struct {
    absl::string_view change;
    absl::string_view message;
  } kCases[] = {
      {"delete table inet rips", "table `inet rips` was deleted"},
      {"flush ruleset", "table `inet rips` was deleted"},
      {"flush chain inet rips level_in", "chain `level_in` was changed"},
      {"insert rule inet rips level_out accept", "chain `level_out` was changed"},
      {"add rule inet rips level_forward drop", "chain `level_forward` was changed"},
      {"insert rule inet rips input accept", "chain `input` was changed"},
      {"flush chain inet rips output", "chain `output` was changed"},
      {"add chain inet rips forward { policy drop; }", "chain `forward` was changed"},
      {"flush set inet rips level_hold", "time of the level's rules is over for ipv4"},
      {"delete element inet rips level_hold { ipv6 }", "is over for ipv6"},
      {"flush set inet rips control4", "server 10.0.0.1 . 7443 is not in `control4`"},
      {"add element inet rips control4 { 10.6.6.6 . 1 }", "the sets of servers have other"},
  };
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  for (const auto& test : kCases) {
    Admin(test.change);
    const FwResponse response = Check(Rules());
    EXPECT_THAT(response.status,
                StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr(test.message)))
        << test.change;
    EXPECT_EQ(response.observed, "firewall=?");
    ASSERT_THAT(Enter(Rules()).status, IsOk()) << test.change;
    EXPECT_THAT(Check(Rules()).status, IsOk()) << test.change;
  }
  FirewallStep other = Rules();
  other.file = other_;
  ASSERT_THAT(Enter(other).status, IsOk());
  EXPECT_THAT(Check(Rules()).status, StatusIs(absl::StatusCode::kFailedPrecondition,
                                              HasSubstr("in force are those of other.nft")));
}

TEST_F(FirewallTest, ATableThatWasSwitchedOffIsSwitchedOn) {
  const FirewallStep kSteps[] = {Rules(), Hosts({"10.0.0.7"}), {.kind = Kind::kRelease}};
  ASSERT_THAT(Enter(Hosts({"10.0.0.7"})).status, IsOk());
  for (const FirewallStep& step : kSteps) {
    ASSERT_THAT(Enter(Rules()).status, IsOk());
    Admin("add table inet rips { flags dormant; }");
    // nft 1.0.6 prints such a table as something that is JSON only by chance.
    EXPECT_FALSE(Check(Rules()).status.ok());
    ASSERT_THAT(Enter(step).status, IsOk());
    EXPECT_THAT(Check(step).status, IsOk());
    EXPECT_FALSE(Now().dormant);
  }
}

TEST_F(FirewallTest, ATryLoadsNothing) {
  const FirewallStep steps[] = {Rules(), Hosts({"10.0.0.7"}), {.kind = Kind::kRelease}};
  for (const FirewallStep& step : steps) {
    const FwResponse tried = Try(step);
    EXPECT_THAT(tried.status, IsOk());
    EXPECT_EQ(tried.note, "nft and the kernel would take it (dry run)");
    EXPECT_FALSE(Now().present) << "a dry run has loaded something";
  }
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  ASSERT_THAT(Enter(Hosts({"10.0.0.8"})).status, IsOk());
  const absl::StatusOr<std::string> before = nft_.ListTable();
  for (const FirewallStep& step : steps) EXPECT_THAT(Try(step).status, IsOk());
  const Ruleset now = Now();
  EXPECT_THAT(now.sets.at("quarantine4"), SizeIs(1));
  EXPECT_THAT(now.chains.at("level_in").comments, ElementsAre("rips 1", "rips 2"));
  // What is in force is still as it was loaded.
  EXPECT_THAT(Check(Rules()).status, IsOk());
  EXPECT_THAT(Check(Hosts({"10.0.0.8"})).status, IsOk());
}

TEST_F(FirewallTest, ATryTellsWhatWouldNotWork) {
  EXPECT_THAT(Try(Hosts({"10.0.0.1"})).status,
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("is a policy server")));
  EXPECT_THAT(Try({.kind = Kind::kRules, .file = "/etc/passwd"}).status,
              StatusIs(absl::StatusCode::kPermissionDenied));
  ASSERT_THAT(WriteFileAtomically(file_, "chain input {\n  nonsense\n}\n"), IsOk());
  EXPECT_THAT(Try(Rules()).status, StatusIs(absl::StatusCode::kInvalidArgument));
  unlink(file_.c_str());
  EXPECT_FALSE(Try(Rules()).status.ok());
  // A table that was switched off is told, and left so.
  ASSERT_THAT(Enter(Hosts({"10.0.0.8"})).status, IsOk());
  Admin("table inet rips { flags dormant; }\n");
  EXPECT_FALSE(Try(Hosts({"10.0.0.7"})).status.ok());
  EXPECT_FALSE(Try({.kind = Kind::kRelease}).status.ok());
}

TEST_F(FirewallTest, TellsWhoIsNoLongerIsolated) {
  const FirewallStep step = Hosts({"10.0.0.7", "10.0.0.8"});
  ASSERT_THAT(Enter(step).status, IsOk());
  EXPECT_THAT(Check(step).status, IsOk());
  Admin("delete element inet rips quarantine4 { 10.0.0.8 }");
  EXPECT_THAT(Check(step).status, StatusIs(absl::StatusCode::kFailedPrecondition,
                                           HasSubstr("no longer isolated: 10.0.0.8")));
  EXPECT_THAT(Enter(step).status, IsOk());
  EXPECT_THAT(Check(step).status, IsOk());
}

TEST_F(FirewallTest, OtherTablesAreLeftAlone) {
  Admin(
      "add table inet admin\nadd chain inet admin input { type filter hook input priority 0; }\n"
      "add rule inet admin input tcp dport 22 accept\n");
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  ASSERT_THAT(Release().status, IsOk());
  Admin("add rule inet admin input tcp dport 23 accept\ndelete table inet admin\n");
}

TEST_F(FirewallTest, AfterARestartTheRulesStandUntilTheyAreAppliedAnew) {
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  const Ruleset before = Now();
  Restart();
  EXPECT_EQ(Now().chains, before.chains);
  EXPECT_THAT(Check(Rules()).status,
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("has started anew")));
  EXPECT_THAT(Enter(Rules()).status, IsOk());
  EXPECT_THAT(Check(Rules()).status, IsOk());
}

TEST_F(FirewallTest, ACheckRenewsTheTime) {
  ASSERT_THAT(Enter(Rules(absl::Seconds(100))).status, IsOk());
  ASSERT_THAT(Enter(Hosts({"10.0.0.7"}, absl::Seconds(100))).status, IsOk());
  EXPECT_THAT(Check(Rules(absl::Seconds(150))).status, IsOk());
  EXPECT_LE(Now().sets.at("level_hold")[0].expires_s, 100) << "more than half is left";
  EXPECT_THAT(Check(Rules(absl::Hours(1))).status, IsOk());
  EXPECT_THAT(Check(Hosts({"10.0.0.7"}, absl::Hours(1))).status, IsOk());
  const Ruleset now = Now();
  EXPECT_GT(now.sets.at("level_hold")[0].expires_s, 3000);
  EXPECT_GT(now.sets.at("level_hold")[1].expires_s, 3000);
  EXPECT_GT(now.sets.at("quarantine4")[0].expires_s, 3000);
  EXPECT_EQ(now.sets.at("quarantine4")[0].since_s, 1000);
}

TEST_F(FirewallTest, TheKernelEndsWhatNobodyRenews) {
  Restart(absl::Seconds(1));
  ASSERT_THAT(Enter(Rules(absl::Seconds(1))).status, IsOk());
  ASSERT_THAT(Enter(Hosts({"10.0.0.7"}, absl::Seconds(1))).status, IsOk());
  const absl::Time limit = absl::Now() + absl::Seconds(60);
  Ruleset now = Now();
  while (!(now.sets["level_hold"].empty() && now.sets["quarantine4"].empty())) {
    ASSERT_LT(absl::Now(), limit);
    absl::SleepFor(absl::Milliseconds(50));
    now = Now();
  }
  EXPECT_THAT(Check(Rules(absl::Seconds(1))).status,
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("is over")));
  EXPECT_THAT(Check(Hosts({"10.0.0.7"}, absl::Seconds(1))).status,
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("no longer isolated")));
}

TEST_F(FirewallTest, AReleaseHoldsTheYoungUntilTheirLeasesHaveEnded) {
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  ASSERT_THAT(Enter(Hosts({"10.0.0.7"})).status, IsOk());
  clock_.Advance(8 * kNanosPerSecond);
  ASSERT_THAT(
      Enter({.kind = Kind::kIsolateParticipants, .targets = {"01104a3b0000000000000001"}}).status,
      IsOk());
  clock_.Advance(7 * kNanosPerSecond);  // 15 s and 7 s

  const FwResponse response = Release();
  ASSERT_THAT(response.status, IsOk());
  EXPECT_EQ(response.observed, "firewall=released");
  EXPECT_EQ(response.note,
            "no longer isolated: 10.0.0.7; isolated until their leases have ended: "
            "01104a3b0000000000000001 in 5s; what their reliable writers have kept "
            "for us comes at once then");
  const Ruleset now = Now();
  EXPECT_THAT(now.sets.at("quarantine4"), IsEmpty());
  ASSERT_THAT(now.sets.at("bad_guid"), SizeIs(1));
  EXPECT_LE(now.sets.at("bad_guid")[0].expires_s, 5);
  EXPECT_THAT(now.sets.at("level_hold"), IsEmpty());
  EXPECT_THAT(now.chains.at("level_in").rules, IsEmpty());
  EXPECT_THAT(Check({.kind = Kind::kRelease}).status, IsOk());
  EXPECT_FALSE(Check(Rules()).status.ok());

  clock_.Advance(5 * kNanosPerSecond);
  EXPECT_THAT(Release().note,
              testing::StartsWith("no longer isolated: 01104a3b0000000000000001; "));
  EXPECT_THAT(Now().sets.at("bad_guid"), IsEmpty());
  EXPECT_EQ(Release().note, "");
}

TEST_F(FirewallTest, AReleaseOfNothingIsOne) {
  EXPECT_THAT(Release().status, IsOk());
  EXPECT_FALSE(Now().present);
  EXPECT_THAT(Release().status, IsOk());
}

TEST_F(FirewallTest, AnElementOfUnknownAgeIsHeldInFull) {
  ASSERT_THAT(Enter(Hosts({"10.0.0.7"})).status, IsOk());
  Admin(
      "add element inet rips quarantine4 { 10.0.0.9 timeout 1h comment \"since 99999\" }\n"
      "add element inet rips quarantine4 { 10.0.0.10 timeout 1h }\n");
  clock_.Advance(20 * kNanosPerSecond);
  EXPECT_THAT(Release().note, HasSubstr("10.0.0.10 in 12s"));
  EXPECT_THAT(Now().sets.at("quarantine4"), SizeIs(2));
}

TEST_F(FirewallTest, AReleaseWorksWhileAServerIsNotKnown) {
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  host_.status = absl::UnavailableError("not known");
  EXPECT_THAT(Release().status, IsOk());
  EXPECT_THAT(Now().chains.at("level_in").rules, IsEmpty());
}

TEST_F(FirewallTest, HasALimitOfIsolated) {
  for (size_t begin = 0; begin < kIsolatedMax; begin += kTargetsMax) {
    std::vector<std::string> targets;
    for (size_t i = begin; i < begin + kTargetsMax; ++i) {
      targets.push_back(absl::StrCat("10.1.", i / 200, ".", 1 + i % 200));
    }
    ASSERT_THAT(Enter(Hosts(targets)).status, IsOk());
  }
  EXPECT_THAT(Enter(Hosts({"10.2.0.1"})).status,
              StatusIs(absl::StatusCode::kResourceExhausted,
                       HasSubstr("isolated in `quarantine4` exceed limit 256")));
  EXPECT_THAT(Enter(Hosts({"10.1.0.1"})).status, IsOk()) << "is there already";
  EXPECT_THAT(Enter(Hosts({"fd00::7"})).status, IsOk()) << "has a set of its own";
  EXPECT_THAT(Release().note, HasSubstr(" more"));
  EXPECT_THAT(Now().sets.at("quarantine4"), SizeIs(kIsolatedMax));
}

TEST_F(FirewallTest, TheStatusNamesWhatIsInForce) {
  const FwRequest status = {.verb = FwVerb::kStatus};
  EXPECT_EQ(firewall_->Handle(status).observed, "firewall=none");
  ASSERT_THAT(Enter(Rules()).status, IsOk());
  ASSERT_THAT(Enter(Hosts({"10.0.0.7"})).status, IsOk());
  const FwResponse response = firewall_->Handle(status);
  EXPECT_EQ(response.observed, "firewall=alert.nft+1isolated");
  EXPECT_THAT(response.note, HasSubstr("10.0.0.7 for "));
  Admin("flush chain inet rips input");
  EXPECT_EQ(firewall_->Handle(status).note, "chain `input` was changed");
}

// Two clients whose requests meet: one transaction after the other, none lost.
TEST_F(FirewallTest, TwoTransactionsAtOnceAreBothInForce) {
  auto listener = ListenAt(directory_ + "/fw", geteuid());
  ASSERT_THAT(listener, IsOk());
  FwServer server(*std::move(listener), geteuid(),
                  [&](const FwRequest& request) { return firewall_->Handle(request); });
  std::thread serving([&] { server.Run(); });
  std::vector<std::thread> clients;
  absl::Status statuses[2];
  for (int which = 0; which < 2; ++which) {
    clients.emplace_back([&, which] {
      FwClient client(directory_ + "/fw");
      for (int i = 1; i <= 5; ++i) {
        const FirewallStep step = which == 0 ? Rules() : Hosts({absl::StrCat("10.0.1.", i)});
        const StepReading reading =
            client.Enter({.what = step}, absl::Seconds(60), 0, CancelFlag());
        statuses[which].Update(reading.status);
      }
    });
  }
  for (std::thread& client : clients) client.join();
  server.Stop();
  serving.join();
  unlink((directory_ + "/fw").c_str());
  EXPECT_THAT(statuses[0], IsOk());
  EXPECT_THAT(statuses[1], IsOk());
  EXPECT_THAT(Check(Rules()).status, IsOk());
  EXPECT_THAT(Now().sets.at("quarantine4"), SizeIs(5));
}

// A kernel, or an nft, that misbehaves.
class FakeNft : public Nft {
 public:
  absl::Status Load(absl::string_view, NftMode mode) override {
    return mode == NftMode::kDryRun ? dry_run : commit;
  }
  absl::StatusOr<std::string> ListTable() override { return list; }

  absl::Status dry_run, commit;
  absl::StatusOr<std::string> list = absl::NotFoundError("table `inet rips` is not there");
};

TEST(FirewallFailureTest, EveryFailureIsTheStepsReason) {
  FakeNft nft;
  FakeHost host;
  FakeClock clock;
  Firewall firewall({}, &nft, &host, &clock);
  const FwRequest isolate = {FwVerb::kEnter,
                             {.kind = Kind::kIsolateHosts, .targets = {"10.0.0.7"}}};
  const auto status = [&] { return firewall.Handle(isolate).status; };
  EXPECT_THAT(status(), StatusIs(absl::StatusCode::kFailedPrecondition,
                                 HasSubstr("nft reported success but the table is not there")));
  nft.list = std::string("{\"nftables\": [{\"table\": {\"name\": \"rips\"}}]}");
  EXPECT_THAT(status(), StatusIs(absl::StatusCode::kFailedPrecondition,
                                 HasSubstr("chain `input` was not loaded as it should be")));
  nft.list = std::string("nonsense");
  EXPECT_THAT(status(), StatusIs(absl::StatusCode::kDataLoss));
  nft.list = absl::NotFoundError("");
  nft.commit = absl::InvalidArgumentError("the kernel refuses");
  EXPECT_THAT(status(), StatusIs(absl::StatusCode::kInvalidArgument, "the kernel refuses"));
  nft.dry_run = absl::DeadlineExceededError("hangs");
  EXPECT_THAT(status(), StatusIs(absl::StatusCode::kDeadlineExceeded, "hangs"));
  nft.list = absl::UnavailableError("cannot start nft");
  EXPECT_THAT(status(), StatusIs(absl::StatusCode::kUnavailable, "cannot start nft"));
  EXPECT_THAT(firewall.Handle({FwVerb::kEnter, {.kind = Kind::kRelease}}).status,
              StatusIs(absl::StatusCode::kUnavailable, "cannot start nft"));
  EXPECT_THAT(firewall.Handle({.verb = FwVerb::kStatus}).status,
              StatusIs(absl::StatusCode::kUnavailable));
}

}  // namespace
}  // namespace rips::actuator
