#include "policy_server/ripsctl/cli/firewalls.h"

#include <algorithm>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <set>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/ripsctl/cli/command.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/robot_level.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

// What was dropped not longer ago is said to go on: an actuator looks every 2 s.
constexpr uint32_t kStillSendsS = 10;
// Two looks, and the way here.
constexpr uint32_t kSurelySendsS = 5;
// Lines of addresses; JSON has all that the server knows.
constexpr size_t kSourcesShown = 10;
// Of one family; a host that drops packets of more does not tell all.
constexpr uint64_t kSourcesCounted = 256;
// All that the server keeps of a robot: programs have receipts, too.
constexpr uint32_t kReceiptsMax = 256;

bool IsFirewall(const v1::StepResult& step) {
  return step.ok() && step.drilled() == v1::StepResult::DRILLED_UNSPECIFIED &&
         absl::StartsWith(step.step(), "firewall ");
}

std::string NewestText(uint32_t quiet_s) {
  if (quiet_s >= kStillSendsS) return absl::StrCat(", none in the last ", quiet_s, " s");
  return absl::StrCat(", the newest less than ", quiet_s + 1, " s ago");
}

// Every address that sent lately is one that agents connect from.
bool OnlyAgentsSend(const v1::HostFirewall& drops) {
  const auto explained = [](const v1::FirewallSource& source) {
    return !source.agents().empty() || source.quiet_s() >= kStillSendsS;
  };
  return !drops.sources().empty() && drops.more_sources() == 0 &&
         std::all_of(drops.sources().begin(), drops.sources().end(), explained);
}

Json SourcesJson(const v1::HostFirewall& drops) {
  Json list = Json::array();
  for (const v1::FirewallSource& source : drops.sources()) {
    Json agents = Json::array();
    for (const std::string& agent : source.agents()) agents.push_back(agent);
    list.push_back({{"address", source.address()},
                    {"packets", source.packets()},
                    {"quiet_s", source.quiet_s()},
                    {"agents", std::move(agents)}});
  }
  return list;
}

bool SameDecision(const v1::DecisionId& a, const v1::DecisionId& b) {
  return a.term() == b.term() && a.epoch() == b.epoch();
}

}  // namespace

absl::StatusOr<std::vector<FirewallOfHost>> ReadFirewalls(Env& env, const std::string& robot,
                                                          const v1::GetLevelResponse& seen) {
  v1::ListReceiptsRequest request;
  request.set_robot(robot);
  request.set_limit(kReceiptsMax);
  RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ListReceipts, request));
  std::vector<FirewallOfHost> firewalls;
  std::set<std::string> settled;
  for (const v1::ReceivedReceipt& each : response.receipts()) {  // newest first
    if (settled.contains(each.host())) continue;
    FirewallOfHost firewall;
    firewall.host = each.host();
    firewall.decision_id = each.receipt().decision_id();
    firewall.renewed = SameDecision(firewall.decision_id, seen.status().decision_id());
    bool released = false;
    for (const v1::StepResult& step : each.receipt().steps()) {
      if (!IsFirewall(step)) continue;
      if (step.step() == "firewall release") {
        // A raise does not run it (mode_actuator/helpers/fw/DESIGN.md, Release).
        released = released || !absl::StartsWith(step.detail(), "not run");
      } else {
        firewall.steps.push_back(step.step());
      }
    }
    if (released || !firewall.steps.empty()) settled.insert(each.host());
    if (firewall.steps.empty()) continue;
    for (const v1::HostFirewall& drops : seen.firewalls()) {
      if (firewall.renewed && drops.host() == firewall.host) firewall.drops = drops;
    }
    firewalls.push_back(std::move(firewall));
  }
  return firewalls;
}

std::string DropsText(const v1::HostFirewall& drops) {
  if (drops.quiet_s() > drops.counted_s()) return "says of what it dropped what cannot be";
  const absl::string_view by_address =
      drops.sources().empty() ? "" : "; by address, which may be forged:";
  if (drops.dropped_packets() == 0) {
    return absl::StrCat("says that it dropped no packet in ", drops.counted_s(), " s", by_address);
  }
  std::string text = absl::StrCat("says that it dropped ", drops.dropped_packets(),
                                  drops.dropped_packets() == 1 ? " packet" : " packets", " in ",
                                  drops.counted_s(), " s");
  absl::StrAppend(&text, NewestText(drops.quiet_s()));
  if (drops.quiet_s() < kStillSendsS) {
    absl::StrAppend(&text, OnlyAgentsSend(drops)
                               ? ": only hosts with agents of RIPS still send, as robots do"
                               : ": something that it keeps out still sends");
    if (drops.sources().empty()) absl::StrAppend(&text, ", the attacker or other hosts");
  }
  return absl::StrCat(text, by_address);
}

std::vector<std::string> SourceLines(const v1::HostFirewall& drops,
                                     const std::map<std::string, std::string>& claims) {
  // Who was named first, then what no agent of ours explains; of each the newest first.
  std::vector<const v1::FirewallSource*> sources;
  for (const v1::FirewallSource& source : drops.sources()) sources.push_back(&source);
  const auto place = [&](const v1::FirewallSource* source) {
    return claims.contains(source->address()) ? 0 : source->agents().empty() ? 1 : 2;
  };
  std::stable_sort(sources.begin(), sources.end(),
                   [&](const auto* a, const auto* b) { return place(a) < place(b); });
  uint64_t more = drops.more_sources();
  if (sources.size() > kSourcesShown) {
    more += sources.size() - kSourcesShown;
    sources.resize(kSourcesShown);
  }
  std::vector<std::string> lines;
  for (const v1::FirewallSource* const each : sources) {
    const v1::FirewallSource& source = *each;
    std::string line = EscapeText(source.address());
    if (!source.agents().empty()) {
      absl::StrAppend(&line, " (", EscapeText(absl::StrJoin(source.agents(), ", ")),
                      source.agents_size() == 1 ? " connects" : " connect", " from there)");
    }
    if (const auto claim = claims.find(source.address()); claim != claims.end()) {
      absl::StrAppend(&line, " (which ", EscapeText(claim->second), " gave as its own",
                      source.agents().empty() ? "; no agent of RIPS is there)" : ")");
    }
    absl::StrAppend(&line, ": ", source.packets(), source.packets() == 1 ? " packet" : " packets",
                    NewestText(source.quiet_s()));
    // That it is silent is no verdict: it may send under another address.
    if (claims.contains(source.address()) && source.quiet_s() < kStillSendsS) {
      absl::StrAppend(&line, source.quiet_s() < kSurelySendsS
                                 ? ": it still sends"
                                 : ": it may still send; look again in 10 s");
    }
    lines.push_back(std::move(line));
  }
  if (more > 0) {
    const bool all = sources.size() + more < kSourcesCounted;
    lines.push_back(absl::StrCat(all ? "" : "at least ", more,
                                 more == 1 ? " other address" : " other addresses",
                                 " in the last 10 min"));
  }
  return lines;
}

void PrintFirewalls(const absl::StatusOr<std::vector<FirewallOfHost>>& firewalls, TextStream out) {
  if (!firewalls.ok()) {
    out << "what its firewalls hold is not known: " << EscapeText(firewalls.status().message())
        << "\n";
    return;
  }
  for (const FirewallOfHost& each : *firewalls) {
    const std::string host = EscapeText(each.host);
    for (const std::string& step : each.steps) {
      if (each.renewed) {
        out << host << " holds `" << EscapeText(step) << "` as long as this level stands\n";
      } else {
        out << host << " may still hold `" << EscapeText(step) << "` of the level before ("
            << DecisionIdText(each.decision_id) << "): no level since has released it, so it "
            << "ends, and lets everything in, when its time is over\n";
      }
    }
    if (each.drops.has_value()) {
      out << host << " " << DropsText(*each.drops) << "\n";
      for (const std::string& line : SourceLines(*each.drops)) out << "  from " << line << "\n";
    } else {
      out << "what " << host << " drops is not known; `nft list table inet rips` there shows it\n";
    }
  }
  if (!firewalls->empty()) out << "what a firewall keeps out may come back when it is released\n";
}

void PrintReleased(Env& env, const std::string& robot,
                   const absl::StatusOr<std::vector<FirewallOfHost>>& before) {
  if (!before.ok() || before->empty()) return;
  const auto now = ReadLevel(env, robot);
  if (!now.ok()) return;
  const auto after = ReadFirewalls(env, robot, *now);
  if (after.ok() && after->empty()) {
    env.out << "its firewall is released: what that kept out can come back\n";
  } else {
    PrintFirewalls(after, env.out);
  }
}

Json FirewallsJson(const absl::StatusOr<std::vector<FirewallOfHost>>& firewalls) {
  if (!firewalls.ok()) return nullptr;
  Json list = Json::array();
  for (const FirewallOfHost& each : *firewalls) {
    Json firewall = {{"host", each.host},
                     {"steps", each.steps},
                     {"decision_id", DecisionIdText(each.decision_id)},
                     {"renewed", each.renewed}};
    const auto& drops = each.drops;
    firewall["dropped_packets"] = drops ? Json(drops->dropped_packets()) : Json(nullptr);
    firewall["counted_s"] = drops ? Json(drops->counted_s()) : Json(nullptr);
    firewall["quiet_s"] = drops ? Json(drops->quiet_s()) : Json(nullptr);
    firewall["sources"] = drops ? SourcesJson(*drops) : Json(nullptr);
    firewall["more_sources"] = drops ? Json(drops->more_sources()) : Json(nullptr);
    list.push_back(std::move(firewall));
  }
  return list;
}

}  // namespace rips::ripsctl
