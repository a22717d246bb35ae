#include "mode_actuator/steps/firewall/nft_script.h"

#include <algorithm>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "absl/strings/substitute.h"

namespace rips::actuator {
namespace {

// $0 = elements of a set of isolated ones, $1 = of a set of servers, $2 = of a set of counted
// sources, $3 = seconds that these stay. A rule that counts a source ends without a verdict where
// the set is full or the packet of the other family: the drop is a rule of its own.
constexpr absl::string_view kTable = R"(add table inet rips
add counter inet rips dropped
add set inet rips dropped4 { type ipv4_addr; size $2; flags dynamic, timeout; timeout $3s; }
add set inet rips dropped6 { type ipv6_addr; size $2; flags dynamic, timeout; timeout $3s; }
add chain inet rips count_and_drop
flush chain inet rips count_and_drop
add rule inet rips count_and_drop update @dropped4 { ip saddr counter }
add rule inet rips count_and_drop update @dropped6 { ip6 saddr counter }
add rule inet rips count_and_drop counter name dropped drop
add set inet rips quarantine4 { type ipv4_addr; size $0; flags timeout; }
add set inet rips quarantine6 { type ipv6_addr; size $0; flags timeout; }
add set inet rips quarantine_mac { type ether_addr; size $0; flags timeout; }
add set inet rips bad_guid { typeof @ih,64,96; size $0; flags timeout; }
add set inet rips level_hold { typeof meta nfproto; size 4; flags timeout; }
add set inet rips control4 { type ipv4_addr . inet_service; size $1; }
add set inet rips control6 { type ipv6_addr . inet_service; size $1; }
add chain inet rips level_in
add chain inet rips level_out
add chain inet rips level_forward
add chain inet rips input { type filter hook input priority -150; policy accept; }
add chain inet rips output { type filter hook output priority -150; policy accept; }
add chain inet rips forward { type filter hook forward priority -150; policy accept; }
flush chain inet rips input
flush chain inet rips output
flush chain inet rips forward
flush set inet rips control4
flush set inet rips control6
add rule inet rips input iifname "lo" accept
add rule inet rips input ip saddr . tcp sport @control4 tcp flags & (syn | ack) != syn accept
add rule inet rips input ip6 saddr . tcp sport @control6 tcp flags & (syn | ack) != syn accept
add rule inet rips output oifname "lo" accept
add rule inet rips output ip daddr . tcp dport @control4 accept
add rule inet rips output ip6 daddr . tcp dport @control6 accept
add rule inet rips forward ip saddr . tcp sport @control4 tcp flags & (syn | ack) != syn accept
add rule inet rips forward ip6 saddr . tcp sport @control6 tcp flags & (syn | ack) != syn accept
add rule inet rips forward ip daddr . tcp dport @control4 accept
add rule inet rips forward ip6 daddr . tcp dport @control6 accept
)";

// `RTPS` is 52 54 50 53; the prefix of the sender follows after version and vendor (DDSI-RTPS 2.5
// §9.4.4): bits 64 to 160 of what UDP carries.
constexpr absl::string_view kBadGuid = "meta l4proto udp @ih,0,32 0x52545053 @ih,64,96 @bad_guid";
// Of what comes from those that are kept out; what we do not send to them is counted by its rule.
constexpr absl::string_view kCountAndDrop = "goto count_and_drop";
constexpr absl::string_view kReachable[] = {
    "icmp type destination-unreachable accept",
    "icmpv6 type { destination-unreachable, packet-too-big, nd-router-solicit, nd-router-advert, "
    "nd-neighbor-solicit, nd-neighbor-advert } accept",
};

// A level that is entered counts its own.
constexpr absl::string_view kForgetSources =
    "flush set inet rips dropped4\nflush set inet rips dropped6\n";

// What our own nodes send by multicast comes back on the interface it left by, and then has no
// Ethernet header. From outside, the kernel takes no IPv4 packet with our own source address, but
// it does take IPv6 ones.
constexpr absl::string_view kOwnMulticast[] = {
    "meta nfproto ipv4 fib saddr type local accept",
    "ether type ip6 fib saddr type local goto count_and_drop",
    // `ip6` first: behind `iiftype ether` nft reads it from the Ethernet header.
    "ip6 daddr ff00::/8 meta iiftype ether fib saddr type local accept",
};

void AddRule(absl::string_view chain, absl::string_view rule, std::string& script) {
  absl::StrAppend(&script, "add rule inet rips ", chain, " ", rule, "\n");
}

// What all three chains have in common, below the servers.
void AddChainEnd(absl::string_view chain, absl::string_view level_chain,
                 const std::vector<absl::string_view>& directions, std::string& script) {
  AddRule(chain, absl::StrCat(kBadGuid, " ", chain == "output" ? "counter drop" : kCountAndDrop),
          script);
  for (const absl::string_view direction : directions) {
    const absl::string_view drop = direction == "saddr" ? kCountAndDrop : "counter drop";
    AddRule(chain, absl::StrCat("ip ", direction, " @quarantine4 ", drop), script);
    AddRule(chain, absl::StrCat("ip6 ", direction, " @quarantine6 ", drop), script);
  }
  // A packet that leaves has no Ethernet header yet.
  if (chain != "output") {
    AddRule(chain, absl::StrCat("ether saddr @quarantine_mac ", kCountAndDrop), script);
  }
  for (const absl::string_view rule : kReachable) AddRule(chain, rule, script);
  if (chain == "input") {
    for (const absl::string_view rule : kOwnMulticast) AddRule(chain, rule, script);
  }
  AddRule(chain, absl::StrCat("meta nfproto @level_hold jump ", level_chain), script);
}

// `text` so that it counts what its verdict drops, if that is the end of what it says: a packet
// that the rest of the rule lets pass is not counted. What is rejected is counted without a source.
std::string Counted(const FragmentRule& rule) {
  if (rule.hook == Hook::kOutput) return rule.text;
  if (rule.text == "drop") return std::string(kCountAndDrop);
  if (rule.text == "reject") return "counter name dropped reject";
  absl::string_view match = rule.text;
  if (absl::ConsumeSuffix(&match, " drop")) return absl::StrCat(match, " ", kCountAndDrop);
  const size_t verdict = absl::EndsWith(rule.text, " reject") ? rule.text.rfind(" reject")
                                                              : rule.text.rfind(" reject with ");
  if (verdict == std::string::npos) return rule.text;
  return absl::StrCat(rule.text.substr(0, verdict), " counter name dropped",
                      rule.text.substr(verdict));
}

std::string ElementOf(const Target& target) {
  if (target.kind == TargetKind::kParticipant) return absl::StrCat("0x", target.text);
  return target.text;
}

int64_t WholeSeconds(absl::Duration hold_for) {
  return std::max<int64_t>(1, absl::ToInt64Seconds(absl::Ceil(hold_for, absl::Seconds(1))));
}

}  // namespace

absl::string_view SetOf(TargetKind kind) {
  switch (kind) {
    case TargetKind::kIpv4:
      return "quarantine4";
    case TargetKind::kIpv6:
      return "quarantine6";
    case TargetKind::kMac:
      return "quarantine_mac";
    case TargetKind::kParticipant:
      return "bad_guid";
  }
  return "";
}

absl::string_view LevelChainOf(Hook hook) {
  switch (hook) {
    case Hook::kInput:
      return "level_in";
    case Hook::kOutput:
      return "level_out";
    case Hook::kForward:
      return "level_forward";
  }
  return "";
}

std::string RuleComment(size_t n) { return absl::StrCat("rips ", n); }

std::string TableScript(const std::vector<ControlAddress>& control) {
  std::string script = absl::Substitute(kTable, kIsolatedMax, kControlMax, kCountedSourcesMax,
                                        absl::ToInt64Seconds(kCountedSourceKept));
  AddChainEnd("input", "level_in", {"saddr"}, script);
  AddChainEnd("output", "level_out", {"daddr"}, script);
  AddChainEnd("forward", "level_forward", {"saddr", "daddr"}, script);
  for (const ControlAddress& server : control) {
    absl::StrAppend(&script, "add element inet rips ",
                    server.kind == TargetKind::kIpv4 ? "control4" : "control6", " { ",
                    server.address, " . ", server.port, " }\n");
  }
  return script;
}

std::string LevelScript(const std::vector<FragmentRule>& rules, absl::Duration hold_for) {
  std::string script = absl::StrCat(kForgetSources);
  for (const Hook hook : {Hook::kInput, Hook::kOutput, Hook::kForward}) {
    absl::StrAppend(&script, "flush chain inet rips ", LevelChainOf(hook), "\n");
  }
  for (size_t i = 0; i < rules.size(); ++i) {
    AddRule(LevelChainOf(rules[i].hook),
            absl::StrCat(Counted(rules[i]), " comment \"", RuleComment(i + 1), "\""), script);
  }
  absl::StrAppend(&script, HoldScript(hold_for));
  return script;
}

std::string HoldScript(absl::Duration hold_for) {
  std::string script;
  for (const absl::string_view family : {"ipv4", "ipv6"}) {
    absl::StrAppend(&script, "add element inet rips level_hold { ", family, " }\n",
                    "delete element inet rips level_hold { ", family, " }\n",
                    "add element inet rips level_hold { ", family, " timeout ",
                    WholeSeconds(hold_for), "s }\n");
  }
  return script;
}

std::string IsolateScript(const std::vector<Isolation>& isolations) {
  std::string script;
  for (const Isolation& isolation : isolations) {
    const std::string element = ElementOf(isolation.target);
    const std::string set = absl::StrCat("element inet rips ", SetOf(isolation.target.kind), " { ");
    // Adding what is there would keep its old time on older kernels.
    absl::StrAppend(&script, "add ", set, element, " }\ndelete ", set, element, " }\nadd ", set,
                    element, " timeout ", WholeSeconds(isolation.hold_for), "s comment \"since ",
                    isolation.since_s, "\" }\n");
  }
  return script;
}

std::string ReleaseScript(const std::vector<Isolation>& kept) {
  std::string script;
  for (const Hook hook : {Hook::kInput, Hook::kOutput, Hook::kForward}) {
    absl::StrAppend(&script, "flush chain inet rips ", LevelChainOf(hook), "\n");
  }
  for (const absl::string_view set :
       {"level_hold", "quarantine4", "quarantine6", "quarantine_mac", "bad_guid"}) {
    absl::StrAppend(&script, "flush set inet rips ", set, "\n");
  }
  absl::StrAppend(&script, kForgetSources);
  absl::StrAppend(&script, IsolateScript(kept));
  return script;
}

}  // namespace rips::actuator
