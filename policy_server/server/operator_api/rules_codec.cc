#include "policy_server/server/operator_api/rules_codec.h"

#include <algorithm>
#include <utility>

#include "absl/strings/escaping.h"
#include "policy_server/server/operator_api/answer_limits.h"
#include "services/text/utf8.h"

namespace rips::operator_api {
namespace {

using rollout::RolloutState;

constexpr uint64_t kSoakMsMax = uint64_t{rollout::kSoakNsMax / kNanosPerMilli};

// `waiting`, `running`, `done` or `stopped`.
std::string StageState(const rollout::RolloutRecord& record, size_t stage) {
  if (stage < record.stage) return "done";
  if (stage > record.stage || record.began_unix_ns == 0) return "waiting";
  return std::string(rollout::ToString(record.state));
}

// Text of a robot may be any bytes; a string field must be UTF-8.
std::string ToUtf8(const std::string& text) {
  return FindInvalidUtf8(text).has_value() ? absl::Utf8SafeCHexEscape(text) : text;
}

void Encode(const shadow::ShadowCounts& counts, rips::v1::ShadowCounts& out) {
  out.set_alerts(counts.alerts);
  out.set_raises(counts.raises);
  out.set_lowerings(counts.lowerings);
  out.set_refusals(counts.refusals);
  out.set_programs(counts.programs);
  out.set_faults(counts.faults);
}

void Encode(const rollout::RolloutRecord& record, rips::v1::Rollout& out) {
  const rollout::RolloutPlan& plan = record.plan;
  out.set_id(plan.id);
  out.set_bundle_id(plan.bundle_id);
  out.set_from_directory(plan.from_directory);
  out.set_name(plan.name);
  out.set_state(std::string(rollout::ToString(record.state)));
  out.set_why(ToUtf8(record.why));
  out.set_rolled_back(ToUtf8(record.rolled_back));
  out.set_operator_(plan.operator_name);
  out.set_reason(plan.reason);
  out.set_began_unix_ns(record.began_unix_ns);
  out.set_ended_unix_ns(record.ended_unix_ns);
  for (size_t i = 0; i < plan.stages.size(); ++i) {
    rips::v1::RolloutStageStatus& stage = *out.add_stages();
    stage.set_state(StageState(record, i));
    for (const std::string& robot : plan.stages[i]) stage.add_robots(robot);
  }
  out.set_soak_ms(static_cast<uint64_t>(plan.soak_ns / kNanosPerMilli));
  out.set_alerts_per_minute_max(plan.alerts_per_minute_max);
  out.set_roll_back_when_stopped(plan.roll_back_when_stopped);
}

}  // namespace

rollout::RobotSelection Decode(const rips::v1::RobotSelection& in) {
  return {.robots = {in.robots().begin(), in.robots().end()},
          .labels = {in.labels().begin(), in.labels().end()},
          .all = in.all()};
}

rollout::ActivateOrder Decode(const rips::v1::ActivateBundleRequest& in) {
  rollout::ActivateOrder order{
      .bundle = in.bundle_id(),
      .robots = Decode(in.robots()),
      .soak_ns = static_cast<int64_t>(std::min(in.soak_ms(), kSoakMsMax)) * kNanosPerMilli,
      .alerts_per_minute_max = in.alerts_per_minute_max(),
      .roll_back_when_stopped = in.roll_back_when_stopped(),
      .reason = in.reason(),
      .dry_run = in.dry_run()};
  for (const rips::v1::RolloutStage& stage : in.stages()) {
    order.stages.push_back({.label = stage.label(), .percent = stage.percent()});
  }
  return order;
}

rips::v1::StoredBundle Encode(const rollout::KeptBundle& bundle) {
  rips::v1::StoredBundle out;
  out.set_id(bundle.id);
  out.set_name(bundle.name);
  out.set_signed_by(bundle.signed_by);
  out.set_stored_unix_ns(bundle.stored_unix_ns);
  out.set_problem(bundle.problem);
  return out;
}

void Encode(const std::vector<rollout::KeptBundle>& bundles, const rollout::RulesStatus& status,
            rips::v1::ListBundlesResponse& out) {
  AnswerRoom room;
  for (const rollout::KeptBundle& bundle : bundles) {
    rips::v1::StoredBundle row = Encode(bundle);
    for (const rollout::RobotRules& rules : status.robots) {
      if (rules.bundle_in_use == bundle.id) row.add_robots(rules.robot);
    }
    if (!room.Take(row)) return;
    *out.add_bundles() = std::move(row);
  }
}

rips::v1::ShadowReport Encode(const shadow::ShadowReport& report) {
  rips::v1::ShadowReport out;
  out.set_bundle_id(report.bundle_id);
  out.set_name(report.name);
  out.set_operator_(report.operator_name);
  out.set_reason(report.reason);
  out.set_began_unix_ns(report.began_unix_ns);
  out.set_events(report.events);
  out.set_missed(report.missed);
  out.set_problem(ToUtf8(report.problem));
  out.set_level(report.level);
  out.set_live_level(report.live_level);
  Encode(report.would, *out.mutable_would());
  Encode(report.live, *out.mutable_live());
  for (const shadow::ShadowRule& rule : report.rules) {
    rips::v1::ShadowRule& row = *out.add_rules();
    row.set_rule(rule.rule);
    row.set_fired(rule.fired);
    row.set_unscanned(rule.unscanned);
    row.set_undecidable(rule.undecidable);
  }
  for (const shadow::ShadowExample& example : report.examples) {
    rips::v1::ShadowExample& row = *out.add_examples();
    row.set_time_unix_ns(example.time_unix_ns);
    row.set_rule(example.rule);
    row.set_kind(example.kind);
    row.set_text(ToUtf8(example.text));
  }
  return out;
}

rips::v1::RobotRules Encode(const rollout::RobotRules& rules) {
  rips::v1::RobotRules out;
  out.set_robot(rules.robot);
  out.set_name(rules.name);
  out.set_bundle_in_use(rules.bundle_in_use);
  out.set_problem(ToUtf8(rules.problem));
  if (rules.shadow) *out.mutable_shadow() = Encode(*rules.shadow);
  if (!rules.activation) return out;
  const rollout::Activation& activation = *rules.activation;
  out.set_activated(activation.bundle_id);
  out.set_operator_(activation.operator_name);
  out.set_activated_unix_ns(activation.time_unix_ns);
  out.set_reason(activation.reason);
  out.set_before(activation.before.value_or(""));
  out.set_can_roll_back(activation.before.has_value());
  return out;
}

void Encode(const rollout::RolloutAnswer& answer, rips::v1::RolloutResponse& out) {
  if (answer.rollout) Encode(*answer.rollout, *out.mutable_rollout());
  out.mutable_rollout()->set_healthy_since_unix_ns(answer.healthy_since_unix_ns.value_or(0));
  for (const std::string& robot : answer.changed) out.add_changed(robot);
  for (const std::string& text : answer.left_out) out.add_left_out(text);
  for (const std::string& text : answer.notes) out.add_notes(text);
}

void Encode(const rollout::RulesStatus& status, rips::v1::GetRulesStatusResponse& out) {
  if (status.rollout) Encode(*status.rollout, *out.mutable_rollout());
  out.mutable_rollout()->set_healthy_since_unix_ns(status.healthy_since_unix_ns.value_or(0));
  out.mutable_rollout()->set_not_healthy_because(ToUtf8(status.not_healthy_because));
  for (const std::string& robot : status.no_answer) out.add_no_answer(robot);
  AnswerRoom room(kAnswerBytesMax - out.ByteSizeLong());
  for (const rollout::RobotRules& rules : status.robots) {
    rips::v1::RobotRules row = Encode(rules);
    if (!room.Take(row)) return out.set_cut(true);
    *out.add_robots() = std::move(row);
  }
}

}  // namespace rips::operator_api
