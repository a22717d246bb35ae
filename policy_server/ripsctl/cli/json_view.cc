#include "policy_server/ripsctl/cli/json_view.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "services/ros2/guid.h"

namespace rips::ripsctl {
namespace {

Json JsonDecisionId(bool present, const v1::DecisionId& decision_id) {
  if (!present || (decision_id.term() == 0 && decision_id.epoch() == 0)) return nullptr;
  return DecisionIdText(decision_id);
}

Json Strings(const google::protobuf::RepeatedPtrField<std::string>& strings) {
  Json list = Json::array();
  for (const std::string& each : strings) list.push_back(each);
  return list;
}

// Each as ToJson gives it.
template <typename Message>
Json List(const google::protobuf::RepeatedPtrField<Message>& messages) {
  Json list = Json::array();
  for (const Message& each : messages) list.push_back(ToJson(each));
  return list;
}

}  // namespace

const char* KindName(v1::Endpoint::Kind kind) {
  switch (kind) {
    case v1::Endpoint::PUBLISHER:
      return "publisher";
    case v1::Endpoint::SUBSCRIBER:
      return "subscriber";
    case v1::Endpoint::SERVICE:
      return "service";
    case v1::Endpoint::CLIENT:
      return "client";
    default:
      return "unknown";
  }
}

std::string GuidText(const std::string& bytes) {
  const absl::StatusOr<ros2::Guid> guid = ros2::GuidFromBytes(bytes);
  return guid.ok() ? ros2::ToString(*guid) : "invalid";
}

std::string AckText(const v1::Acknowledgement& ack) {
  return absl::StrCat("at ", ShortTime(ack.time_unix_ns()), " by ", EscapeText(ack.by()),
                      ack.note().empty() ? "" : absl::StrCat(": ", EscapeText(ack.note())));
}

std::string DecisionIdText(const v1::DecisionId& decision_id) {
  if (decision_id.term() == 0 && decision_id.epoch() == 0) return "-";
  return absl::StrCat(decision_id.term(), ".", decision_id.epoch());
}

Json ToJson(const v1::AgentContact& agent) {
  const bool heard = agent.heard_unix_ns() != 0;
  return {{"role", agent.role()},
          {"host", agent.host()},
          {"version", agent.version()},
          {"heard", heard ? Json(FullTime(agent.heard_unix_ns())) : Json(nullptr)},
          {"heard_ago_ms", heard ? Json(agent.heard_ago_ms()) : Json(nullptr)}};
}

Json ToJson(const v1::Maintenance& maintenance) {
  return {{"began", FullTime(maintenance.began_unix_ns())},
          {"until", FullTime(maintenance.until_unix_ns())},
          {"operator", maintenance.operator_()},
          {"reason", maintenance.reason()}};
}

Json ToJson(const v1::RobotStatus& status) {
  Json json = {
      {"robot", status.robot()},
      {"decided_level", status.decided_level()},
      {"effective_level", status.effective_level()},
      {"stage", status.stage()},
      {"decision_id", JsonDecisionId(status.has_decision_id(), status.decision_id())},
      {"bundle", status.bundle_version()},
      {"degraded", Strings(status.degraded())},
      {"degraded_cut", status.degraded_cut()},
      {"pending_approvals", status.pending_approvals()},
      {"maintenance", status.has_maintenance() ? ToJson(status.maintenance()) : Json(nullptr)}};
  if (!status.agents().empty()) json["agents"] = List(status.agents());
  if (status.has_findings()) {
    json["findings"] = status.findings();
    json["findings_not_known"] = status.findings_not_known();
  }
  return json;
}

Json ToJson(const v1::Transition& transition) {
  return {{"id", transition.id()},
          {"robot", transition.robot()},
          {"time", FullTime(transition.time_unix_ns())},
          {"from", transition.from()},
          {"to", transition.to()},
          {"cause", transition.cause()},
          {"reason", transition.reason()},
          {"decision_id", JsonDecisionId(transition.has_decision_id(), transition.decision_id())},
          {"refused", transition.refused()},
          {"count", transition.count()},
          {"stage", transition.stage()},
          {"detail", transition.detail()}};
}

Json ToJson(const v1::Alert& alert) {
  return {{"id", alert.id()},
          {"time", FullTime(alert.time_unix_ns())},
          {"robot", alert.robot()},
          {"rule", alert.rule()},
          {"severity", alert.severity()},
          {"text", alert.text()},
          {"level", alert.level()},
          {"event", alert.event()},
          {"decision_id", JsonDecisionId(alert.has_decision_id(), alert.decision_id())},
          {"maintenance", alert.maintenance()},
          {"subjects", List(alert.subjects())}};
}

Json ToJson(const v1::Acknowledgement& ack) {
  return {{"by", ack.by()}, {"time", FullTime(ack.time_unix_ns())}, {"note", ack.note()}};
}

Json AlertWithAck(const v1::Alert& alert) {
  Json json = ToJson(alert);
  json["acknowledged"] = alert.has_acknowledged() ? ToJson(alert.acknowledged()) : Json(nullptr);
  return json;
}

Json ToJson(const v1::Subject& subject) {
  return {{"name", subject.name()},
          {"role", subject.role()},
          {"guid", subject.guid()},
          {"host", subject.host()},
          {"pid", subject.pid() == 0 ? Json(nullptr) : Json(subject.pid())},
          {"address", subject.address()}};
}

Json ToJson(const v1::Evidence& evidence) {
  Json values = Json::array();
  for (const v1::EvidenceValue& each : evidence.values()) {
    values.push_back({{"offset", each.offset()},
                      {"length", each.length()},
                      {"depth", each.depth()},
                      {"value", each.value()}});
  }
  const int64_t time = evidence.event_unix_ns();
  return {{"place", evidence.place()},
          {"condition", evidence.condition()},
          {"values", std::move(values)},
          {"subjects", List(evidence.subjects())},
          {"event", evidence.event()},
          {"event_time", time == 0 ? Json(nullptr) : Json(FullTime(time))},
          {"bundle", evidence.bundle()},
          {"cut", evidence.cut()}};
}

Json ToJson(const v1::ExplainResponse& response) {
  Json alerts = Json::array();
  for (const v1::Alert& each : response.alerts()) alerts.push_back(AlertWithAck(each));
  return {{"alert", response.has_alert() ? AlertWithAck(response.alert()) : Json(nullptr)},
          {"transition", response.has_transition() ? ToJson(response.transition()) : Json(nullptr)},
          {"evidence", response.has_evidence() ? ToJson(response.evidence()) : Json(nullptr)},
          {"alerts", std::move(alerts)},
          {"transitions", List(response.transitions())}};
}

Json ToJson(const v1::PendingApproval& pending) {
  return {{"id", pending.id()},
          {"from", pending.from()},
          {"to", pending.to()},
          {"decision_id", JsonDecisionId(true, pending.decision_id())},
          {"operator", pending.operator_()},
          {"reason", pending.reason()},
          {"accept_blind", pending.accept_blind()},
          {"changes", Strings(pending.changes())},
          {"asked", FullTime(pending.asked_unix_ns())},
          {"expires", FullTime(pending.expires_unix_ns())}};
}

Json ToJson(const v1::GetLevelResponse& response) {
  Json levels = Json::array();
  for (const std::string& name : response.levels()) {
    const bool soft = std::find(response.soft_levels().begin(), response.soft_levels().end(),
                                name) != response.soft_levels().end();
    const auto& two = response.two_person_levels();
    const bool two_person = std::find(two.begin(), two.end(), name) != two.end();
    levels.push_back({{"name", name}, {"soft", soft}, {"two_person", two_person}});
  }
  Json pending = Json::array();
  for (const v1::PendingApproval& each : response.pending_approvals()) {
    pending.push_back(ToJson(each));
  }
  Json lowering = Json::array();
  for (const v1::LoweringRule& each : response.lowering_rules()) {
    lowering.push_back({{"rule", each.rule()},
                        {"holds", each.has_holds() ? Json(each.holds()) : Json(nullptr)},
                        {"evidence", ToJson(each.evidence())}});
  }
  return {{"status", ToJson(response.status())},
          {"levels", std::move(levels)},
          {"last", response.has_last() ? ToJson(response.last()) : Json(nullptr)},
          {"pending_approvals", std::move(pending)},
          {"rules_cannot_lower_because", response.has_rules_cannot_lower_because()
                                             ? Json(response.rules_cannot_lower_because())
                                             : Json(nullptr)},
          {"lowering_rules", std::move(lowering)}};
}

void PrintJson(const Json& json, TextStream out) {
  out.Raw(json.dump(-1, ' ', /*ensure_ascii=*/true, Json::error_handler_t::replace));
  out << std::endl;
}

}  // namespace rips::ripsctl
