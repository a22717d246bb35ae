#include "policy_server/server/robot/sight/graph_health.h"

#include <algorithm>

#include "absl/container/flat_hash_set.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/robot/context/own_participants.h"
#include "services/model/dds_problem.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {
namespace {

// Parts that a problem names.
constexpr size_t kPartsNamed = 3;

// `/safety/change_mode` is of `/safety`.
absl::string_view OwnerOf(absl::string_view service) {
  const size_t slash = service.rfind('/');
  return slash == absl::string_view::npos ? absl::string_view() : service.substr(0, slash);
}

std::string Listed(const std::vector<std::string>& parts) {
  const size_t named = std::min(parts.size(), kPartsNamed);
  std::string list = absl::StrJoin(parts.begin(), parts.begin() + named, ", ");
  if (named < parts.size()) absl::StrAppend(&list, " and ", parts.size() - named, " more");
  return list;
}

// It is over before the grace mostly, and must be known all the same.
bool IsUrgent(absl::string_view reason) {
  return absl::StrContains(reason, model::kDdsBeginsAgain);
}

// What is on the bus besides RIPS.
struct Seen {
  bool anything = false;
  // Full names of nodes, and of what services belong to by their name. Views into the graph.
  absl::flat_hash_set<absl::string_view> parts;
};

Seen Others(const ros2::RosGraph& graph, const std::vector<ros2::Guid>& own_participants) {
  const absl::flat_hash_set<ros2::Guid> own(own_participants.begin(), own_participants.end());
  Seen seen;
  for (const ros2::Node& node : graph.nodes()) {
    if (node.full_name == kRipsNode || own.contains(node.participant)) continue;
    seen.anything = true;
    seen.parts.insert(node.full_name);
  }
  for (const auto& [guid, endpoint] : graph.endpoints()) {
    if (!endpoint.ros || endpoint.pending || endpoint.node == kRipsNode) continue;
    if (own.contains(guid.Participant())) continue;
    seen.anything = true;
    if (endpoint.kind == ros2::EndpointKind::kService) seen.parts.insert(OwnerOf(endpoint.name));
  }
  return seen;
}

}  // namespace

GraphHealth ExamineGraph(const ros2::RosGraph& graph, const GraphExpectation& expected) {
  GraphHealth health;
  if (graph.truncated()) {
    health.truncated = absl::StrCat("graph truncated: the graph of sensor ", expected.sensor,
                                    " hit a limit, so not all of the robot is in it");
  }
  const Seen seen = Others(graph, expected.own_participants);
  if (!seen.anything) {
    health.empty = true;
    health.problems.push_back(absl::StrCat(
        "sensor ", expected.sensor, " sees no ROS node on domain ", expected.domain,
        expected.moved ? " since its host's addresses changed; start the ROS nodes again"
                       : "; are dds.domain and dds.interface right?"));
    return health;
  }
  std::vector<std::string> missing;
  for (const std::string& part : expected.parts) {
    if (!seen.parts.contains(part)) missing.push_back(part);
  }
  if (!missing.empty()) {
    health.problems.push_back(absl::StrCat("sensor ", expected.sensor, " does not see ",
                                           Listed(missing), " on domain ", expected.domain,
                                           ", whose modes the actuator sets"));
  }
  return health;
}

std::string DescribeParticipant(const ros2::RosGraph& graph, const ros2::Guid& participant) {
  std::vector<std::string> known;
  const auto found = graph.participants().find(participant);
  if (found != graph.participants().end()) {
    const ros2::Participant& claims = found->second;
    if (!claims.host.empty()) known.push_back(absl::StrCat("host ", ros2::Printable(claims.host)));
    if (claims.pid != 0) known.push_back(absl::StrCat("pid ", claims.pid));
  }
  std::vector<std::string> nodes;
  for (const ros2::Node& node : graph.nodes()) {
    if (node.participant == participant) nodes.push_back(node.full_name);
  }
  if (!nodes.empty()) {
    known.push_back(absl::StrCat(nodes.size() == 1 ? "node " : "nodes ", Listed(nodes)));
  }
  return absl::StrCat("participant ", ToString(participant), known.empty() ? "" : " (",
                      absl::StrJoin(known, ", "), known.empty() ? "" : ")");
}

std::string LargestParticipant(const ros2::RosGraph& graph) {
  struct Size {
    uint64_t nodes = 0;
    uint64_t endpoints = 0;
    uint64_t left_out = 0;

    // Counts of a sensor are claims: their sum may not fit.
    double all() const {
      return static_cast<double>(nodes) + static_cast<double>(endpoints) +
             static_cast<double>(left_out);
    }
  };
  absl::btree_map<ros2::Guid, Size> sizes;
  for (const ros2::Node& node : graph.nodes()) ++sizes[node.participant].nodes;
  for (const auto& [guid, endpoint] : graph.endpoints()) {
    const bool observes =
        endpoint.node == kRipsNode && endpoint.kind == ros2::EndpointKind::kSubscriber;
    if (!observes) ++sizes[guid.Participant()].endpoints;
  }
  for (const ros2::Truncation::Crowd& crowd : graph.truncation().crowds) {
    Size& size = sizes[crowd.participant];
    size.left_out = crowd.left_out;
    size.endpoints = std::max(size.endpoints, crowd.endpoints);
  }
  const auto largest = std::max_element(
      sizes.begin(), sizes.end(),
      [](const auto& a, const auto& b) { return a.second.all() < b.second.all(); });
  if (largest == sizes.end()) return "";
  const Size& size = largest->second;
  std::string left_out;
  if (size.left_out > 0) left_out = absl::StrCat(", ", size.left_out, " more left out");
  return absl::StrCat(DescribeParticipant(graph, largest->first), " has ", size.nodes, " of ",
                      graph.nodes().size(), " nodes and ", size.endpoints, " of ",
                      graph.endpoints().size(), " endpoints", left_out, "; ",
                      graph.participants().size(), " participants");
}

void BlindAlarm::Set(const std::vector<std::string>& reasons, int64_t now_ns) {
  const absl::flat_hash_set<absl::string_view> now(reasons.begin(), reasons.end());
  for (auto it = reasons_.begin(); it != reasons_.end();) {
    Reason& reason = it->second;
    if (now.contains(it->first)) {
      reason.gone_ns.reset();
    } else if (!reason.gone_ns.has_value()) {
      reason.gone_ns = now_ns;
    }
    const bool forgotten = reason.gone_ns.has_value() && ((!reason.told && !IsUrgent(it->first)) ||
                                                          now_ns - *reason.gone_ns >= kForgetNs);
    it = forgotten ? reasons_.erase(it) : std::next(it);
  }
  for (const std::string& text : reasons) {
    if (reasons_.size() >= kReasonsMax) break;
    reasons_.try_emplace(text, Reason{.since_ns = now_ns});
  }
}

std::vector<std::string> BlindAlarm::Due(int64_t now_ns) {
  std::vector<std::string> due;
  for (auto& [text, reason] : reasons_) {
    if (reason.told) continue;
    const bool waits = reason.gone_ns.has_value() || now_ns - reason.since_ns < kGraceNs;
    if (waits && !IsUrgent(text)) continue;
    reason.told = told_ = true;
    due.push_back(text);
  }
  return due;
}

bool BlindAlarm::Over() {
  if (!told_) return false;
  for (const auto& [text, reason] : reasons_) {
    if (reason.told && !reason.gone_ns.has_value()) return false;
  }
  told_ = false;
  return true;
}

}  // namespace rips::pipeline
