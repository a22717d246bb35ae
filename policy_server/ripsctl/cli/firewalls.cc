#include "policy_server/ripsctl/cli/firewalls.h"

#include <nlohmann/json.hpp>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/ripsctl/cli/command.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

// What was dropped not longer ago is said to go on: an actuator looks every 2 s.
constexpr uint32_t kStillSendsS = 10;

FirewallOfHost OfReceipt(const v1::ReceivedReceipt& received, const v1::GetLevelResponse& seen) {
  FirewallOfHost firewall;
  firewall.host = received.host();
  for (const v1::StepResult& step : received.receipt().steps()) {
    if (!step.ok() || !absl::StartsWith(step.step(), "firewall ")) continue;
    if (step.step() != "firewall release") firewall.steps.push_back(step.step());
  }
  for (const v1::HostFirewall& drops : seen.firewalls()) {
    if (drops.host() == firewall.host) firewall.drops = drops;
  }
  return firewall;
}

}  // namespace

absl::StatusOr<std::vector<FirewallOfHost>> ReadFirewalls(Env& env, const std::string& robot,
                                                          const v1::GetLevelResponse& seen) {
  v1::ListReceiptsRequest request;
  request.set_robot(robot);
  RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ListReceipts, request));
  const v1::DecisionId& level = seen.status().decision_id();
  std::vector<FirewallOfHost> firewalls;
  std::set<std::string> hosts;
  for (const v1::ReceivedReceipt& each : response.receipts()) {  // newest first
    const v1::DecisionId& of = each.receipt().decision_id();
    if (of.term() != level.term() || of.epoch() != level.epoch()) continue;
    if (!hosts.insert(each.host()).second) continue;
    FirewallOfHost firewall = OfReceipt(each, seen);
    if (!firewall.steps.empty()) firewalls.push_back(std::move(firewall));
  }
  return firewalls;
}

std::string DropsText(const v1::HostFirewall& drops) {
  if (drops.dropped_packets() == 0) {
    return absl::StrCat("has dropped no packet in ", drops.counted_s(), " s");
  }
  return absl::StrCat("has dropped ", drops.dropped_packets(),
                      drops.dropped_packets() == 1 ? " packet" : " packets", " in ",
                      drops.counted_s(), " s, ",
                      drops.quiet_s() < kStillSendsS
                          ? absl::StrCat("the newest less than ", drops.quiet_s() + 1,
                                         " s ago: something that it keeps out still sends")
                          : absl::StrCat("none in the last ", drops.quiet_s(), " s"));
}

void PrintFirewalls(const absl::StatusOr<std::vector<FirewallOfHost>>& firewalls,
                    std::ostream& out) {
  if (!firewalls.ok()) {
    out << "what its firewalls hold is not known: " << EscapeText(firewalls.status().message())
        << "\n";
    return;
  }
  for (const FirewallOfHost& each : *firewalls) {
    const std::string host = EscapeText(each.host);
    for (const std::string& step : each.steps) {
      out << host << " holds `" << EscapeText(step)
          << "` until a level releases it or its time is over\n";
    }
    if (each.drops.has_value()) {
      out << host << " " << DropsText(*each.drops) << "\n";
    } else {
      out << "what " << host << " drops is not known; `nft list table inet rips` there shows it\n";
    }
  }
  if (!firewalls->empty()) out << "what a firewall keeps out may come back when it is released\n";
}

Json FirewallsJson(const absl::StatusOr<std::vector<FirewallOfHost>>& firewalls) {
  if (!firewalls.ok()) return nullptr;
  Json list = Json::array();
  for (const FirewallOfHost& each : *firewalls) {
    Json firewall = {{"host", each.host}, {"steps", each.steps}};
    const auto& drops = each.drops;
    firewall["dropped_packets"] = drops ? Json(drops->dropped_packets()) : Json(nullptr);
    firewall["counted_s"] = drops ? Json(drops->counted_s()) : Json(nullptr);
    firewall["quiet_s"] = drops ? Json(drops->quiet_s()) : Json(nullptr);
    list.push_back(std::move(firewall));
  }
  return list;
}

}  // namespace rips::ripsctl
