#include "policy_server/server/operator_api/coverage_codec.h"

#include <algorithm>
#include <string>
#include <tuple>
#include <utility>
#include <vector>

#include "policy_server/server/ingest/interest_codec.h"
#include "policy_server/server/operator_api/answer_limits.h"
#include "policy_server/server/store/trace_codec.h"
#include "services/ros2/guid.h"
#include "services/ros2_proto/graph_codec.h"

namespace rips::operator_api {
namespace {

void Encode(const pipeline::SensorCoverage& sensor, rips::v1::SensorCoverage& out) {
  out.set_host(sensor.host);
  out.set_primary(sensor.primary);
  out.set_connected(sensor.connected);
  out.set_settled(sensor.settled);
  for (const std::string& kind : sensor.state.not_visible) {
    out.add_not_visible(kind);
    out.mutable_state()->add_not_visible(kind);
  }
  for (const std::string& reason : sensor.state.blind) out.mutable_state()->add_blind(reason);
  rips::v1::SensorState* state = out.mutable_state();
  state->set_overloaded(sensor.state.overloaded);
  state->set_outbox_bytes(sensor.state.outbox_bytes);
  state->set_oldest_unacked_ns(static_cast<uint64_t>(sensor.state.oldest_unacked_ns));
  state->set_spool_bytes(sensor.state.spool_bytes);
  out.set_lost(sensor.lost);
  if (sensor.clock_skew_ns.has_value()) out.set_clock_skew_ns(*sensor.clock_skew_ns);
}

void Encode(const pipeline::FindingSeen& finding, rips::v1::Finding& out) {
  out.set_kind(finding.kind);
  if (!finding.guid.none()) out.set_guid(finding.guid.ToBytes());
  out.set_node(finding.node);
  out.set_topic(finding.topic);
  out.set_detail(finding.detail);
}

void Encode(const pipeline::FindingsNow& now, rips::v1::FindingsNow& out) {
  out.set_total(now.total);
  for (const auto& [kind, count] : now.kinds) {
    rips::v1::FindingCount* one = out.add_kinds();
    one->set_kind(kind);
    one->set_count(count);
  }
  for (const pipeline::StandingFinding& standing : now.newest) {
    rips::v1::StandingFinding* one = out.add_newest();
    Encode(standing.finding, *one->mutable_finding());
    one->set_since_unix_ns(standing.since_unix_ns);
    for (const engine::TracedSubject& subject : standing.subjects) {
      *one->add_subjects() = store::EncodeSubject(subject);
    }
  }
  for (const std::string& reason : now.not_known) out.add_not_known(reason);
}

const char* NameOf(pipeline::FindingState::State state) {
  switch (state) {
    case pipeline::FindingState::State::kStands:
      return "stands";
    case pipeline::FindingState::State::kEnded:
      return "ended";
    case pipeline::FindingState::State::kNotKnown:
      break;
  }
  return "not known";
}

void Encode(const pipeline::FindingState& state, rips::v1::FindingState& out) {
  out.set_state(NameOf(state.state));
  out.set_since_unix_ns(state.since_unix_ns);
  out.set_ended_unix_ns(state.ended_unix_ns);
  for (const std::string& reason : state.not_known) out.add_not_known(reason);
}

void EncodeFindings(const pipeline::Robot& robot, const rips::v1::GetCoverageRequest& request,
                    rips::v1::GetCoverageResponse& out) {
  const pipeline::FindingsKnown& findings = robot.core().findings().known();
  Encode(findings.Now(), *out.mutable_findings_now());
  if (!request.has_finding()) return;
  const rips::v1::Finding& asked = request.finding();
  Encode(findings.StateOf({.kind = asked.kind(),
                           .guid = ros2::GuidFromBytes(asked.guid()).value_or(ros2::Guid{}),
                           .node = asked.node(),
                           .topic = asked.topic()}),
         *out.mutable_finding_state());
}

// Findings, and then endpoints, as far as there is room.
void EncodeLists(const pipeline::Robot& robot, rips::v1::GetCoverageResponse& out) {
  AnswerRoom room(kAnswerBytesMax - std::min(kAnswerBytesMax, out.ByteSizeLong()));
  AnswerRoom for_findings(room.left() / 2);
  for (const pipeline::FindingSeen& finding : robot.core().findings().known().standing()) {
    rips::v1::Finding one;
    Encode(finding, one);
    if (!for_findings.Take(one) || !room.Take(one)) {
      out.set_findings_left_out(out.findings_left_out() + 1);
      continue;
    }
    *out.add_findings() = std::move(one);
  }
  std::vector<const ros2::Endpoint*> endpoints;
  endpoints.reserve(robot.core().graph().endpoints().size());
  for (const auto& [guid, endpoint] : robot.core().graph().endpoints())
    endpoints.push_back(&endpoint);
  std::sort(endpoints.begin(), endpoints.end(),
            [](const ros2::Endpoint* a, const ros2::Endpoint* b) {
              return std::tie(a->name, a->kind, a->guid) < std::tie(b->name, b->kind, b->guid);
            });
  for (const ros2::Endpoint* endpoint : endpoints) {
    rips::v1::Endpoint one;
    ros2_proto::EncodeEndpoint(*endpoint, one);
    if (!room.Take(one)) {
      out.set_endpoints_left_out(out.endpoints_left_out() + 1);
      continue;
    }
    *out.add_endpoints() = std::move(one);
  }
}

}  // namespace

void EncodeInterest(const pipeline::Robot& robot, rips::v1::GetInterestResponse& out) {
  // What a policy that runs muted asks for, too.
  const pipeline::Policy& policy = robot.core().policy();
  const pipeline::Watch& watch = robot.core().watch();
  *out.mutable_interest() =
      ingest::EncodeInterest(*watch.plan(policy), watch.limits(policy), *watch.kept_topics(policy));
  AnswerRoom room(kAnswerBytesMax / 2);
  for (const engine::TopicInterest& row : *watch.plan(policy)) {
    rips::v1::InterestReason reason;
    for (const std::string& rule : row.wanted_by) reason.add_wanted_by(rule);
    if (!room.Take(reason)) reason.clear_wanted_by();
    *out.add_reasons() = std::move(reason);
  }
  for (const pipeline::SensorInterest& sensor : robot.core().sight().Interests()) {
    rips::v1::SensorInterest* one = out.add_sensors();
    one->set_host(sensor.host);
    one->set_connected(sensor.connected);
    one->set_in_use(sensor.in_use);
    one->set_problem(sensor.problem);
  }
}

rips::v1::RobotStatus EncodeListed(const pipeline::Robot& robot) {
  rips::v1::RobotStatus out = EncodeStatus(robot.Status());
  const pipeline::FindingsKnown& findings = robot.core().findings().known();
  out.set_findings(findings.total());
  out.set_findings_not_known(!findings.NotKnown().empty());
  return out;
}

void EncodeCoverage(const pipeline::Robot& robot, const rips::v1::GetCoverageRequest& request,
                    rips::v1::GetCoverageResponse& out) {
  EncodeFindings(robot, request, out);
  if (request.findings_only()) return;
  for (const pipeline::SensorCoverage& sensor : robot.core().sight().Coverage()) {
    Encode(sensor, *out.add_sensors());
  }
  out.set_graph_truncated(robot.core().graph().truncated());
  for (const auto& [reason, count] : robot.core().losses().Skipped()) {
    rips::v1::SkippedInspections* skipped = out.add_skipped();
    skipped->set_reason(reason);
    skipped->set_count(count);
  }
  for (const std::string& reason : robot.core().sight().blind()) out.add_blind(reason);
  for (const pipeline::CutPayloads::Topic& cut : robot.core().sight().CutTopics()) {
    rips::v1::CutPayloads* one = out.add_cut_payloads();
    one->set_topic(cut.topic);
    one->set_limit_bytes(cut.limit_bytes);
    one->set_longest_bytes(cut.longest_bytes);
    one->set_count(cut.count);
  }
  EncodeLists(robot, out);
}

}  // namespace rips::operator_api
