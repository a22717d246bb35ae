#include "policy_server/server/operator_api/level_codec.h"

#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/operator_api/answer_limits.h"
#include "policy_server/server/store/trace_codec.h"
#include "services/model_proto/decision_id_codec.h"

namespace rips::operator_api {

namespace {

// Several are behind one address where there is NAT.
constexpr size_t kAgentsNamedMax = 4;

rips::v1::PendingApproval EncodePending(const pipeline::PendingApproval& pending) {
  rips::v1::PendingApproval out;
  out.set_id(pending.id);
  out.set_from(pending.from);
  out.set_to(pending.to);
  model_proto::Encode(pending.decision_id, *out.mutable_decision_id());
  out.set_operator_(pending.operator_name);
  out.set_reason(pending.reason);
  out.set_accept_blind(pending.accept_blind);
  out.set_asked_unix_ns(pending.asked_unix_ns);
  out.set_expires_unix_ns(pending.expires_unix_ns);
  for (const std::string& change : pending.changes) out.add_changes(change);
  return out;
}

}  // namespace

void Encode(const pipeline::LevelAnswer& answer, rips::v1::LevelResponse& out) {
  model_proto::Encode(answer.decision_id, *out.mutable_decision_id());
  out.set_decided_level(answer.decided_level);
  out.set_soft(answer.soft);
  for (const std::string& rule : answer.would_raise_again) out.add_would_raise_again(rule);
  for (const std::string& reason : answer.blind_because) out.add_blind_because(reason);
  out.set_needs_approval(answer.needs_approval);
  out.set_pending_approval_id(answer.pending_approval_id);
  out.set_approval_expires_unix_ns(answer.approval_expires_unix_ns);
}

void Encode(const pipeline::LevelAnswer& answer, rips::v1::ResetTermResponse& out) {
  model_proto::Encode(answer.decision_id, *out.mutable_decision_id());
  out.set_decided_level(answer.decided_level);
}

void EncodeLevels(const pipeline::RobotCore& core, bool lowering_rules,
                  rips::v1::GetLevelResponse& out) {
  const pipeline::RobotStatus status = core.Status();
  *out.mutable_status() = EncodeStatus(status);
  const levels::LevelTable& levels = core.levels();
  for (int i = 0; i < levels.size(); ++i) {
    out.add_levels(levels.name(i));
    if (levels.at(i).soft) out.add_soft_levels(levels.name(i));
  }
  if (std::optional<std::string> why = core.WhyRulesCannotLower()) {
    out.set_rules_cannot_lower_because(*std::move(why));
  }
  if (lowering_rules) {
    for (const auto& rule : core.LoweringRules()) {
      rips::v1::LoweringRule& to = *out.add_lowering_rules();
      to.set_rule(rule.name);
      if (rule.holds) to.set_holds(*rule.holds);
      *to.mutable_evidence() = store::EncodeTrace(rule.trace);
    }
  }
  for (const std::string& level : core.policy().two_person) out.add_two_person_levels(level);
  for (const pipeline::PendingApproval& pending : status.pending_approvals) {
    *out.add_pending_approvals() = EncodePending(pending);
  }
  for (const auto& [host, drops] : core.actuators().FirewallDrops()) {
    rips::v1::HostFirewall& firewall = *out.add_firewalls();
    firewall.set_host(host);
    firewall.set_dropped_packets(drops.packets);
    firewall.set_counted_s(drops.counted_s);
    firewall.set_quiet_s(drops.quiet_s);
    for (const model::DropSource& source : drops.sources) {
      rips::v1::FirewallSource& out_source = *firewall.add_sources();
      out_source.set_address(source.address);
      out_source.set_packets(source.packets);
      out_source.set_quiet_s(source.quiet_s);
    }
    firewall.set_more_sources(drops.more_sources);
  }
}

void NameAgents(const pipeline::AgentContacts& contacts, rips::v1::GetLevelResponse& out) {
  for (rips::v1::HostFirewall& firewall : *out.mutable_firewalls()) {
    for (rips::v1::FirewallSource& source : *firewall.mutable_sources()) {
      for (const pipeline::AgentId& agent : contacts.At(source.address(), kAgentsNamedMax)) {
        source.add_agents(
            absl::StrCat(agent.kind == pipeline::AgentKind::kSensor ? "sensor/" : "actuator/",
                         agent.robot, "/", agent.host));
      }
    }
  }
}

}  // namespace rips::operator_api
