// Messages of OperatorService as tests of ripsctl use them: robot r1 at COMPROMISED (3.17).
#ifndef RIPS_POLICY_SERVER_RIPSCTL_SAMPLES_H_
#define RIPS_POLICY_SERVER_RIPSCTL_SAMPLES_H_

#include <cstdint>
#include <string>

#include "policy_server/policy/recording/rips_writer.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

inline constexpr int64_t kNewYear = 1'767'225'600'000'000'000;

inline v1::DecisionId MakeDecisionId(uint64_t term, uint64_t epoch) {
  v1::DecisionId decision_id;
  decision_id.set_term(term);
  decision_id.set_epoch(epoch);
  return decision_id;
}

inline v1::RobotStatus MakeStatus(const std::string& robot, const std::string& level) {
  v1::RobotStatus status;
  status.set_robot(robot);
  status.set_decided_level(level);
  status.set_effective_level(level);
  status.set_stage("verified");
  *status.mutable_decision_id() = MakeDecisionId(3, 17);
  status.set_bundle_version("sha256:" + std::string(64, 'b'));
  return status;
}

inline void AddEndpoint(v1::Endpoint::Kind kind, const std::string& node, const std::string& name,
                        const std::string& type, bool ros, v1::GraphSnapshot& graph) {
  v1::Endpoint* endpoint = graph.add_endpoints();
  endpoint->set_guid(std::string("\x01\x10\x4a\x3b", 4) + std::string(10, '\0') + "\x03\xc1");
  endpoint->set_kind(kind);
  endpoint->set_node(node);
  endpoint->set_name(name);
  endpoint->set_type(type);
  endpoint->set_ros(ros);
}

inline v1::GraphSnapshot MakeGraph() {
  v1::GraphSnapshot graph;
  graph.set_settled(true);
  graph.add_nodes()->set_full_name("/talker");
  graph.add_nodes()->set_full_name("/listener");
  AddEndpoint(v1::Endpoint::SUBSCRIBER, "/rips", "/chatter", "std_msgs/msg/String", true, graph);
  AddEndpoint(v1::Endpoint::SUBSCRIBER, "/listener", "/chatter", "std_msgs/msg/String", true,
              graph);
  AddEndpoint(v1::Endpoint::PUBLISHER, "/talker", "/chatter", "std_msgs/msg/String", true, graph);
  AddEndpoint(v1::Endpoint::SERVICE, "/talker", "/talker/get_parameters", "x", true, graph);
  AddEndpoint(v1::Endpoint::PUBLISHER, "", "/cmd_vel", "geometry_msgs/msg/Twist", true, graph);
  AddEndpoint(v1::Endpoint::SUBSCRIBER, "", "raw_topic", "T", false, graph);
  return graph;
}

// Until 18:20 of the new year's day, by carol.
inline v1::Maintenance MakeMaintenance() {
  constexpr int64_t kMinute = 60'000'000'000;
  v1::Maintenance maintenance;
  maintenance.set_began_unix_ns(kNewYear);
  maintenance.set_until_unix_ns(kNewYear + (18 * 60 + 20) * kMinute);
  maintenance.set_operator_("carol (spiffe://td/operator/operator/carol serial 0c)");
  maintenance.set_reason("kernel \x1b[2J");
  return maintenance;
}

// `ago_ms` 0: it was not heard.
inline void AddAgent(const std::string& role, const std::string& version, uint64_t ago_ms,
                     v1::RobotStatus& status) {
  v1::AgentContact* agent = status.add_agents();
  agent->set_role(role);
  agent->set_host("base");
  agent->set_version(version);
  agent->set_heard_unix_ns(ago_ms == 0 ? 0 : kNewYear);
  agent->set_heard_ago_ms(ago_ms);
}

// r1 and r2; only r1 with one label, none with more.
inline v1::ListRobotsResponse MakeRobotList(const v1::ListRobotsRequest& request) {
  v1::ListRobotsResponse response;
  response.set_server_version("0.1.0");
  if (request.labels_size() > 1) return response;
  v1::RobotStatus& first = *response.add_robots();
  first = MakeStatus("r1", "COMPROMISED");
  AddAgent("sensor", "0.1.0", 3'000, first);
  if (request.labels_size() > 0) return response;
  v1::RobotStatus& second = *response.add_robots();
  second = MakeStatus("r2", "DEFAULT");
  second.clear_effective_level();
  second.add_degraded("sensor base lost");
  second.add_degraded("\x1b[2Jactuator");
  AddAgent("sensor", "\x1b]0;old\x07", 172'800'000, second);
  AddAgent("actuator", "", 0, second);
  return response;
}

// The file of a recording, with one event, a second and a half after its start.
inline std::string MakeAlertRecording() {
  const recording::RecordedOrigin origin{
      .robot = "r1",
      .bundle_id = "sha256:0123456789",
      .level = "ALERT",
      .start_unix_ns = kNewYear,
      .alerts = {{.id = std::string(32, '1'), .rule = "rogue", .text = "who drives\x1b[1m?"}}};
  return *recording::EncodeStart(origin) +
         *recording::EncodeFrame({.time_unix_ns = kNewYear + 1'500'000'000,
                                  .what = model::SignalSeen{.name = "SIGUSR1"}});
}

// Of 100 bytes each.
template <typename Writer>
void SendInPieces(const std::string& file, Writer& writer) {
  for (size_t at = 0; at < file.size(); at += 100) {
    v1::FilePiece piece;
    piece.set_data(file.substr(at, 100));
    piece.set_file_bytes(file.size());
    writer.Write(piece);
  }
}

inline v1::Transition MakeTransition() {
  v1::Transition transition;
  transition.set_id(std::string(32, '1'));
  transition.set_robot("r1");
  transition.set_time_unix_ns(kNewYear + 5);
  transition.set_from("ALERT");
  transition.set_to("COMPROMISED");
  transition.set_cause("rule rogue_cmd_vel");
  *transition.mutable_decision_id() = MakeDecisionId(3, 17);
  transition.set_count(1);
  transition.set_stage("verified");
  return transition;
}

inline v1::Alert MakeAlert(const std::string& text) {
  v1::Alert alert;
  alert.set_id(std::string(32, '2'));
  alert.set_time_unix_ns(kNewYear);
  alert.set_robot("r1");
  alert.set_rule("unknown_node");
  alert.set_severity("high");
  alert.set_text(text);
  alert.set_level("ALERT");
  alert.set_event("graph change");
  *alert.mutable_decision_id() = MakeDecisionId(3, 16);
  return alert;
}

// `r1 100 open severity high rule x within 1`, what is set of it.
inline std::string FilterText(const v1::ListAlertsRequest& request) {
  const auto with = [](const char* name, const std::string& value) {
    return value.empty() || value == "0" ? "" : name + value;
  };
  return request.robot() + " " + std::to_string(request.limit()) + (request.open() ? " open" : "") +
         with(" severity ", request.severity()) + with(" rule ", request.rule()) +
         with(" within ", std::to_string(request.within_ms()));
}

// Rule rogue_cmd_vel of two lines, three values of two depths, one subject.
inline v1::Evidence MakeEvidence() {
  v1::Evidence evidence;
  evidence.set_place("warehouse.rul:31");
  evidence.set_condition("publisher_count(\"/cmd_vel\") > 1\n      and !nodes(\"/teleop\")");
  const auto add = [&evidence](uint32_t offset, uint32_t length, uint32_t depth,
                               const std::string& value) {
    v1::EvidenceValue* each = evidence.add_values();
    each->set_offset(offset);
    each->set_length(length);
    each->set_depth(depth);
    each->set_value(value);
  };
  add(0, 59, 0, "true");
  add(0, 27, 1, "2");
  add(42, 17, 1, "not evaluated");
  v1::Subject* subject = evidence.add_subjects();
  subject->set_name("/intruder");
  subject->set_role("publishes /cmd_vel");
  subject->set_guid("01104a3b.00000000.00000000.000003c1");
  subject->set_host("base");
  subject->set_pid(4711);
  subject->set_address("10.0.0.66");
  evidence.set_event("graph change");
  evidence.set_event_unix_ns(kNewYear - 1'000'000);
  evidence.set_bundle("sha256:" + std::string(64, 'b'));
  return evidence;
}

// Of participant and topic.
inline v1::Finding MakeFinding() {
  v1::Finding finding;
  finding.set_kind("non_ros_reader");
  finding.set_guid(std::string("\x01\x10\x4a\x3b", 4) + std::string(10, '\0') + "\x01\xc1");
  finding.set_topic("/camera");
  return finding;
}

inline v1::Subject MakeReader() {
  v1::Subject subject;
  subject.set_name("/camera");
  subject.set_role("finding non_ros_reader");
  subject.set_guid("01104a3b.00000000.00000000.000001c1");
  subject.set_host("lab-pc");
  subject.set_pid(4711);
  subject.set_address("10.0.0.66");
  return subject;
}

// RIPS's own alert of that finding, as it is explained.
inline v1::ExplainResponse MakeFindingExplained() {
  v1::ExplainResponse explained;
  v1::Alert& alert = *explained.mutable_alert();
  alert = MakeAlert("sensor base: finding non_ros_reader, topic /camera");
  alert.set_rule("(rips)");
  alert.set_event("finding non_ros_reader");
  *alert.add_subjects() = MakeReader();
  *explained.mutable_finding() = MakeFinding();
  return explained;
}

// The answer of a server on which so many findings stand, the newest of them MakeFinding.
inline v1::GetCoverageResponse MakeFindings(uint64_t total) {
  v1::GetCoverageResponse response;
  v1::FindingsNow& now = *response.mutable_findings_now();
  now.set_total(total);
  if (total == 0) return response;
  v1::FindingCount* count = now.add_kinds();
  count->set_kind("non_ros_reader");
  count->set_count(total);
  v1::StandingFinding& newest = *now.add_newest();
  *newest.mutable_finding() = MakeFinding();
  newest.mutable_finding()->set_detail("reads without a node \x1b[2J");
  newest.set_since_unix_ns(kNewYear);
  *newest.add_subjects() = MakeReader();
  return response;
}

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_SAMPLES_H_
