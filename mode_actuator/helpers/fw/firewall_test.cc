// The firewall on the kernel's own packet filter, in a network namespace of this test's thread:
// the host is not touched, and nothing is left behind.
#include "mode_actuator/helpers/fw/firewall.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <linux/if_packet.h>
#include <net/if.h>
#include <netinet/in.h>
#include <poll.h>
#include <sched.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <map>
#include <thread>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
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
#include "services/runtime/run_to_end.h"
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
    UniqueFd outside(open("/proc/thread-self/ns/net", O_RDONLY | O_CLOEXEC));
    if (unshare(CLONE_NEWNET) != 0) {
      ASSERT_EQ(errno, EPERM) << std::strerror(errno);
      GTEST_SKIP() << "network namespaces are not allowed here";
    }
    outside_ = std::move(outside);
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
  // By chain: how many rules count, with their source and without.
  std::map<std::string, int> by_source, counting;
  for (const auto& entry : table["nftables"]) {
    if (!entry.contains("rule")) continue;
    const std::string chain = entry["rule"]["chain"];
    for (const auto& each : entry["rule"]["expr"]) {
      if (each.contains("counter") && each["counter"] == "dropped") ++counting[chain];
      if (each.contains("goto")) ++by_source[chain];
    }
  }
  EXPECT_THAT(counting, UnorderedElementsAre(Pair("level_in", 2), Pair("count_and_drop", 1)));
  // The table's own: a participant; hosts by IPv4, IPv6 and MAC, where they come from; what comes in
  // and claims to come from here.
  EXPECT_THAT(by_source, UnorderedElementsAre(Pair("level_in", 2), Pair("level_forward", 1),
                                              Pair("input", 5), Pair("forward", 4)));
  EXPECT_EQ(Check(rules).dropped, DropCount());
  EXPECT_EQ(Check({.kind = Kind::kRelease}).dropped, std::nullopt);
}

// A link of this namespace, both ends: what is written to `far` arrives at `near`.
class FirewallDropsTest : public FirewallTest {
 protected:
  void SetUp() override {
    FirewallTest::SetUp();
    if (IsSkipped() || HasFatalFailure()) return;
    for (const absl::string_view words :
         {"link add far type veth peer name near", "link set far up",
          "link set near address 02:00:00:00:00:02 up", "address add 10.5.0.2/16 dev near",
          "-6 address add fd05::2/16 dev near nodad", "route add 10.0.0.1/32 dev near"}) {
      ProgramCall ip = {.words = {"/usr/sbin/ip"}, .timeout = absl::Seconds(60)};
      for (const absl::string_view word : absl::StrSplit(words, ' ')) ip.words.emplace_back(word);
      const absl::StatusOr<ProgramEnd> end = RunToEnd(ip);
      ASSERT_THAT(end, IsOk());
      ASSERT_EQ(end->exit_code, 0) << words << ": " << end->err;
    }
    raw_ = UniqueFd(socket(AF_PACKET, SOCK_RAW | SOCK_CLOEXEC, 0));
    ASSERT_GE(raw_.get(), 0) << std::strerror(errno);
    ASSERT_THAT(WriteFileAtomically(other_, "chain input {\n  udp dport 7400 drop\n}\n"), IsOk());
    rules_ = Rules();
    rules_.file = other_;
    ASSERT_THAT(Enter(rules_).status, IsOk());
  }

  // A UDP datagram for port 7400 that says it comes from there.
  void Send(const std::string& from) {
    SendIp(from, 17, absl::string_view("\x10\x00\x1c\xe8\0\x09\0\0x", 9));
  }
  // A TCP segment for port 22 with these flags that says it comes from a policy server.
  void SendTcp(uint8_t flags) {
    std::string tcp("\x1d\x13\0\x16\0\0\0\x01\0\0\0\0\x50\0\x10\0\0\0\0\0", 20);
    tcp[13] = static_cast<char>(flags);
    SendIp("10.0.0.1", 6, tcp);
  }
  void SendIp(const std::string& from, char protocol, absl::string_view payload) {
    const bool v4 = from.find(':') == from.npos;
    std::string frame("\x02\0\0\0\0\x02\x02\0\0\0\0\x01", 12);
    const char length = static_cast<char>(payload.size());
    char source[16] = {}, target[16] = {};
    ASSERT_EQ(inet_pton(v4 ? AF_INET : AF_INET6, from.c_str(), source), 1);
    ASSERT_EQ(inet_pton(v4 ? AF_INET : AF_INET6, v4 ? "10.5.0.2" : "fd05::2", target), 1);
    if (v4) {
      std::string ip("\x45\0\0\0\0\0\0\0\x40\0\0\0", 12);
      ip[3] = static_cast<char>(20 + length);
      ip[9] = protocol;
      ip.append(source, 4).append(target, 4);
      const uint16_t sum = Checksum(ip);
      ip[10] = static_cast<char>(sum >> 8);
      ip[11] = static_cast<char>(sum & 0xff);
      absl::StrAppend(&frame, absl::string_view("\x08\0", 2), ip, payload);
    } else {
      std::string ip("\x60\0\0\0\0\0\0\x40", 8);
      ip[5] = length;
      ip[6] = protocol;
      ip.append(source, 16).append(target, 16);
      absl::StrAppend(&frame, "\x86\xdd", ip, payload);
    }
    sockaddr_ll to = {};
    to.sll_family = AF_PACKET;
    to.sll_ifindex = static_cast<int>(if_nametoindex("far"));
    ASSERT_EQ(sendto(raw_.get(), frame.data(), frame.size(), 0, reinterpret_cast<sockaddr*>(&to),
                     sizeof(to)),
              static_cast<ssize_t>(frame.size()))
        << std::strerror(errno);
  }
  static uint16_t Checksum(absl::string_view header) {
    uint32_t sum = 0;
    for (size_t i = 0; i < header.size(); i += 2) {
      sum += static_cast<uint8_t>(header[i]) << 8 | static_cast<uint8_t>(header[i + 1]);
    }
    while (sum > 0xffff) sum = (sum & 0xffff) + (sum >> 16);
    return static_cast<uint16_t>(~sum);
  }
  // Once as many were dropped.
  DropCount Dropped(uint64_t packets) {
    DropCount count;
    for (int i = 0; i < 500; ++i) {
      count = Check(rules_).dropped.value_or(DropCount());
      if (count.packets >= packets) break;
      absl::SleepFor(absl::Milliseconds(10));
    }
    EXPECT_EQ(count.packets, packets);
    for (model::DropSource& source : count.sources) {
      EXPECT_LE(source.quiet_s, 60u);  // from the kernel's clock, on a busy machine
      source.quiet_s = 0;
    }
    return count;
  }

  UniqueFd raw_;
  FirewallStep rules_;
};

TEST_F(FirewallDropsTest, AreCountedBySourceOfBothFamilies) {
  for (int i = 0; i < 3; ++i) Send("10.5.0.66");
  for (int i = 0; i < 2; ++i) Send("fd05::66");
  Send("10.5.0.13");
  const DropCount count = Dropped(6);
  EXPECT_THAT(count.sources, UnorderedElementsAre(model::DropSource{"10.5.0.66", 3, 0},
                                                  model::DropSource{"fd05::66", 2, 0},
                                                  model::DropSource{"10.5.0.13", 1, 0}));
  EXPECT_EQ(count.more_sources, 0u);
  // A level that is entered counts its own; the table goes on.
  ASSERT_THAT(Enter(rules_).status, IsOk());
  EXPECT_THAT(Dropped(6).sources, IsEmpty());
}

TEST_F(FirewallDropsTest, OfMoreSourcesThanAreCountedAreDroppedAllTheSame) {
  constexpr int kMany = kCountedSourcesMax + 44;
  for (int i = 0; i < kMany; ++i) Send(absl::StrCat("10.5.", 1 + i / 200, ".", 1 + i % 200));
  for (int i = 0; i < kMany; ++i) Send(absl::StrCat("fd05::", absl::Hex(0x1000 + i)));
  const DropCount count = Dropped(2 * kMany);
  EXPECT_THAT(count.sources, SizeIs(model::kDropSourcesMax));
  EXPECT_EQ(count.more_sources, 2 * kCountedSourcesMax - model::kDropSourcesMax);
}

TEST_F(FirewallDropsTest, WhatClaimsToComeFromThisHostIsDropped) {
  Send("fd05::2");
  EXPECT_THAT(Dropped(1).sources, ElementsAre(model::DropSource{"fd05::2", 1, 0}));
}

TEST_F(FirewallDropsTest, OurOwnMulticastComesBack) {
  ASSERT_THAT(WriteFileAtomically(other_, "chain input {\n  drop\n}\n"), IsOk());
  ASSERT_THAT(Enter(rules_).status, IsOk());
  const UniqueFd reader(socket(AF_INET6, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  sockaddr_in6 at = {};
  at.sin6_family = AF_INET6;
  ASSERT_EQ(bind(reader.get(), reinterpret_cast<sockaddr*>(&at), sizeof(at)), 0);
  socklen_t size = sizeof(at);
  ASSERT_EQ(getsockname(reader.get(), reinterpret_cast<sockaddr*>(&at), &size), 0);
  ipv6_mreq group = {};
  group.ipv6mr_interface = if_nametoindex("near");
  ASSERT_EQ(inet_pton(AF_INET6, "ff02::7", &group.ipv6mr_multiaddr), 1);
  ASSERT_EQ(setsockopt(reader.get(), IPPROTO_IPV6, IPV6_JOIN_GROUP, &group, sizeof(group)), 0);
  at.sin6_addr = group.ipv6mr_multiaddr;
  at.sin6_scope_id = group.ipv6mr_interface;
  ASSERT_EQ(sendto(reader.get(), "own", 3, 0, reinterpret_cast<sockaddr*>(&at), sizeof(at)), 3)
      << std::strerror(errno);
  pollfd polled = {.fd = reader.get(), .events = POLLIN, .revents = 0};
  EXPECT_EQ(poll(&polled, 1, 30'000), 1);
}

TEST_F(FirewallDropsTest, NoConnectionBeginsAtAServer) {
  ASSERT_THAT(WriteFileAtomically(other_, "chain input {\n  drop\n}\n"), IsOk());
  ASSERT_THAT(Enter(rules_).status, IsOk());
  constexpr uint8_t kSyn = 2, kAck = 16;
  SendTcp(kAck);  // of a connection to it
  SendTcp(kSyn | kAck);
  SendTcp(kSyn);
  EXPECT_THAT(Dropped(1).sources, ElementsAre(model::DropSource{"10.0.0.1", 1, 0}));
}

TEST_F(FirewallDropsTest, TheNewestSourceComesFirst) {
  Admin("add element inet rips dropped4 { 10.5.0.7 timeout 600s expires 300s }");
  Admin("add element inet rips dropped4 { 10.5.0.8 timeout 600s expires 590s }");
  Admin("add element inet rips dropped6 { fd05::8 timeout 600s expires 400s }");
  const std::optional<DropCount> count = Check(rules_).dropped;
  ASSERT_TRUE(count.has_value());
  ASSERT_THAT(count->sources, SizeIs(3));
  EXPECT_EQ(count->sources[0].address, "10.5.0.8");
  EXPECT_EQ(count->sources[1].address, "fd05::8");
  EXPECT_EQ(count->sources[2].address, "10.5.0.7");
  EXPECT_GE(count->sources[2].quiet_s, 300u);
}

TEST_F(FirewallDropsTest, AChainThatNoLongerDropsIsADrift) {
  Admin("flush chain inet rips count_and_drop");
  EXPECT_THAT(Check(rules_).status,
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("count_and_drop")));
  ASSERT_THAT(Enter(rules_).status, IsOk());
  EXPECT_THAT(Check(rules_).status, IsOk());
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
