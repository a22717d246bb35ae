#include "services/ros2/ros_graph.h"

#include <algorithm>
#include <iterator>

#include "absl/container/flat_hash_set.h"
#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::ros2 {
namespace {

// The first possible endpoint of a participant; endpoints are ordered by GUID.
Guid LowestGuid(const Guid& participant) {
  Guid lowest = participant;
  std::fill(lowest.bytes.end() - 4, lowest.bytes.end(), uint8_t{0});
  return lowest;
}

// How the endpoint stands among a topic's publishers and subscribers.
std::string Label(const Endpoint& endpoint) {
  if (!endpoint.node.empty()) return endpoint.node;
  return absl::StrCat("(unattributed ", ToString(endpoint.guid), ")");
}

bool IsAnswered(const Endpoint& endpoint) { return endpoint.ros && !endpoint.pending; }

void InsertSorted(std::vector<std::string>& names, const std::string& name) {
  names.insert(std::upper_bound(names.begin(), names.end(), name), name);
}

void EraseSorted(std::vector<std::string>& names, const std::string& name) {
  const auto at = std::lower_bound(names.begin(), names.end(), name);
  if (at != names.end() && *at == name) names.erase(at);
}

absl::Status CheckPrintable(absl::string_view what, absl::string_view text) {
  if (text.empty()) return absl::InvalidArgumentError(absl::StrCat("empty ", what));
  if (text.size() > kPrintableBytesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat(what, " of ", text.size(), " bytes exceeds limit ", kPrintableBytesMax));
  }
  for (char c : text) {
    if (!absl::ascii_isprint(c)) {
      return absl::InvalidArgumentError(absl::StrCat(what, " holds a byte that is not printable"));
    }
  }
  return absl::OkStatus();
}

absl::Status CheckEndpointNames(const Endpoint& endpoint) {
  RIPS_RETURN_IF_ERROR(CheckPrintable("type", endpoint.type));
  if (endpoint.ros) return ValidateTopicName(endpoint.name);
  return CheckPrintable("DDS topic name", endpoint.name);
}

// What a delta takes away, for questions of the form "is it there afterwards?".
struct Gone {
  explicit Gone(const GraphDelta& delta)
      : guids(delta.gone_guids.begin(), delta.gone_guids.end()),
        nodes(delta.gone_nodes.begin(), delta.gone_nodes.end()),
        upserted_nodes(delta.upsert_nodes.begin(), delta.upsert_nodes.end()) {
    for (const Participant& participant : delta.upsert_participants) {
      upserted_guids.insert(participant.guid);
    }
    for (const Endpoint& endpoint : delta.upsert_endpoints) upserted_guids.insert(endpoint.guid);
  }

  absl::flat_hash_set<Guid> guids;
  absl::flat_hash_set<std::string> nodes;
  absl::btree_set<Node> upserted_nodes;
  absl::flat_hash_set<Guid> upserted_guids;
};

}  // namespace

absl::Status RosGraph::Check(const GraphDelta& delta) const {
  const Gone gone(delta);
  const auto has_participant = [&](const Guid& guid) {
    return gone.upserted_guids.contains(guid) ||
           (participants_.contains(guid) && !gone.guids.contains(guid));
  };
  const auto has_node = [&](const Node& node) {
    return gone.upserted_nodes.contains(node) ||
           (nodes_.contains(node) && !gone.nodes.contains(node.full_name) &&
            !gone.guids.contains(node.participant));
  };
  for (const Participant& participant : delta.upsert_participants) {
    if (participant.guid != participant.guid.Participant()) {
      return absl::InvalidArgumentError(
          absl::StrCat("`", ToString(participant.guid), "` is not a participant's GUID"));
    }
  }
  for (const Node& node : delta.upsert_nodes) {
    RIPS_RETURN_IF_ERROR(ValidateNodeName(node.full_name));
    if (!truncated() && !has_participant(node.participant)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "node `", node.full_name, "` names unknown participant ", ToString(node.participant)));
    }
  }
  for (const Endpoint& endpoint : delta.upsert_endpoints) {
    RIPS_RETURN_IF_ERROR(CheckEndpointNames(endpoint));
    const Guid participant = endpoint.guid.Participant();
    if (endpoint.guid == participant) {
      return absl::InvalidArgumentError(
          absl::StrCat("`", ToString(endpoint.guid), "` is not an endpoint's GUID"));
    }
    if (!truncated() && !has_participant(participant)) {
      return absl::InvalidArgumentError(
          absl::StrCat("endpoint ", ToString(endpoint.guid), " is of an unknown participant"));
    }
    if (!truncated() && !endpoint.node.empty() && !has_node({endpoint.node, participant})) {
      return absl::InvalidArgumentError(absl::StrCat("endpoint ", ToString(endpoint.guid),
                                                     " names unknown node `",
                                                     Printable(endpoint.node), "`"));
    }
  }
  if (truncated() || gone.nodes.empty()) return absl::OkStatus();
  for (const auto& [guid, endpoint] : endpoints_) {
    if (!gone.nodes.contains(endpoint.node) || gone.guids.contains(guid) ||
        gone.guids.contains(guid.Participant()) || gone.upserted_guids.contains(guid) ||
        has_node({endpoint.node, guid.Participant()})) {
      continue;
    }
    return absl::InvalidArgumentError(absl::StrCat("endpoint ", ToString(guid), " of node `",
                                                   endpoint.node, "` would outlive it"));
  }
  return absl::OkStatus();
}

absl::Status RosGraph::Apply(const GraphDelta& delta) {
  RIPS_RETURN_IF_ERROR(Check(delta));
  for (const Guid& guid : delta.gone_guids) {
    RemoveParticipant(guid);
    RemoveEndpoint(guid);
  }
  for (const std::string& name : delta.gone_nodes) {
    const auto begin = nodes_.lower_bound(Node{name, Guid{}});
    const auto end =
        std::find_if(begin, nodes_.end(), [&](const Node& node) { return node.full_name != name; });
    nodes_.erase(begin, end);
  }
  for (const Participant& participant : delta.upsert_participants) {
    if (participants_.size() >= limits_.participants && !participants_.contains(participant.guid)) {
      ++dropped_;
      continue;
    }
    participants_[participant.guid] = participant;
  }
  for (const Node& node : delta.upsert_nodes) {
    if (nodes_.contains(node)) continue;
    if (nodes_.size() >= limits_.nodes || !participants_.contains(node.participant)) {
      ++dropped_;
      continue;
    }
    nodes_.insert(node);
  }
  for (const Endpoint& endpoint : delta.upsert_endpoints) {
    RemoveEndpoint(endpoint.guid);
    const Guid participant = endpoint.guid.Participant();
    const bool known = participants_.contains(participant) &&
                       (endpoint.node.empty() || nodes_.contains({endpoint.node, participant}));
    if (!known || endpoints_.size() >= limits_.endpoints || !Index(endpoint)) {
      ++dropped_;
      continue;
    }
    endpoints_.emplace(endpoint.guid, endpoint);
  }
  if (!truncated() || delta.gone_nodes.empty()) return absl::OkStatus();
  // A node that was to come back may have found no room.
  std::vector<Guid> orphans;
  for (const auto& [guid, endpoint] : endpoints_) {
    if (!endpoint.node.empty() && !nodes_.contains({endpoint.node, guid.Participant()})) {
      orphans.push_back(guid);
    }
  }
  for (const Guid& guid : orphans) RemoveEndpoint(guid);
  dropped_ += orphans.size();
  return absl::OkStatus();
}

void RosGraph::Clear() { *this = RosGraph(limits_); }

void RosGraph::RemoveParticipant(const Guid& guid) {
  if (participants_.erase(guid) == 0) return;
  for (auto node = nodes_.begin(); node != nodes_.end();) {
    node = node->participant == guid ? nodes_.erase(node) : std::next(node);
  }
  const auto begin = endpoints_.lower_bound(LowestGuid(guid));
  auto end = begin;
  for (; end != endpoints_.end() && end->first.SamePrefix(guid); ++end) Unindex(end->second);
  endpoints_.erase(begin, end);
}

void RosGraph::RemoveEndpoint(const Guid& guid) {
  const auto at = endpoints_.find(guid);
  if (at == endpoints_.end()) return;
  Unindex(at->second);
  endpoints_.erase(at);
}

bool RosGraph::Index(const Endpoint& endpoint) {
  if (!IsAnswered(endpoint)) return true;
  if (endpoint.kind == EndpointKind::kClient) return true;
  if (endpoint.kind == EndpointKind::kService) {
    ++services_of_node_[endpoint.node][endpoint.name];
    return true;
  }
  if (topics_.size() >= limits_.topics && !topics_.contains(endpoint.name)) return false;
  Topic& topic = topics_[endpoint.name];
  const bool publishes = endpoint.kind == EndpointKind::kPublisher;
  InsertSorted(publishes ? topic.publishers : topic.subscribers, Label(endpoint));
  if (++types_of_topic_[endpoint.name][endpoint.type] == 1) {
    InsertSorted(topic.types, endpoint.type);
  }
  return true;
}

void RosGraph::Unindex(const Endpoint& endpoint) {
  if (!IsAnswered(endpoint) || endpoint.kind == EndpointKind::kClient) return;
  const bool service = endpoint.kind == EndpointKind::kService;
  auto& index = service ? services_of_node_ : types_of_topic_;
  const std::string& owner = service ? endpoint.node : endpoint.name;
  const std::string& counted = service ? endpoint.name : endpoint.type;
  Counts& counts = index[owner];
  const bool last = --counts[counted] == 0;
  if (last) counts.erase(counted);
  if (counts.empty()) index.erase(owner);
  if (service) return;
  const auto at = topics_.find(endpoint.name);
  Topic& topic = at->second;
  const bool publishes = endpoint.kind == EndpointKind::kPublisher;
  EraseSorted(publishes ? topic.publishers : topic.subscribers, Label(endpoint));
  if (last) EraseSorted(topic.types, endpoint.type);
  if (topic.publishers.empty() && topic.subscribers.empty()) topics_.erase(at);
}

GraphDelta RosGraph::Diff(const RosGraph& from, const RosGraph& to) {
  GraphDelta delta;
  for (const auto& [guid, participant] : from.participants_) {
    if (!to.participants_.contains(guid)) delta.gone_guids.push_back(guid);
  }
  for (const auto& [guid, participant] : to.participants_) {
    const auto old = from.participants_.find(guid);
    if (old == from.participants_.end() || old->second != participant) {
      delta.upsert_participants.push_back(participant);
    }
  }
  for (const Node& node : from.nodes_) {
    if (to.nodes_.contains(node) || !to.participants_.contains(node.participant)) continue;
    // Nodes are ordered by name: equal names come one after the other.
    if (delta.gone_nodes.empty() || delta.gone_nodes.back() != node.full_name) {
      delta.gone_nodes.push_back(node.full_name);
    }
  }
  for (const Node& node : to.nodes_) {
    const bool swept =
        std::binary_search(delta.gone_nodes.begin(), delta.gone_nodes.end(), node.full_name);
    if (swept || !from.nodes_.contains(node)) delta.upsert_nodes.push_back(node);
  }
  for (const auto& [guid, endpoint] : from.endpoints_) {
    if (!to.endpoints_.contains(guid) && to.participants_.contains(guid.Participant())) {
      delta.gone_guids.push_back(guid);
    }
  }
  for (const auto& [guid, endpoint] : to.endpoints_) {
    const auto old = from.endpoints_.find(guid);
    if (old == from.endpoints_.end() || old->second != endpoint) {
      delta.upsert_endpoints.push_back(endpoint);
    }
  }
  return delta;
}

const Topic* RosGraph::FindTopic(absl::string_view name) const {
  const auto at = topics_.find(name);
  return at == topics_.end() ? nullptr : &at->second;
}

std::vector<std::string> RosGraph::ServicesOf(absl::string_view node) const {
  std::vector<std::string> services;
  const auto at = services_of_node_.find(node);
  if (node.empty() || at == services_of_node_.end()) return services;
  for (const auto& [service, count] : at->second) services.push_back(service);
  return services;
}

const Endpoint* RosGraph::FindEndpoint(const Guid& guid) const {
  const auto at = endpoints_.find(guid);
  return at == endpoints_.end() ? nullptr : &at->second;
}

bool NodeNameMatches(absl::string_view name, absl::string_view full_name) {
  if (name.find('/') != absl::string_view::npos) return name == full_name;
  const size_t slash = full_name.rfind('/');
  const size_t base = slash == absl::string_view::npos ? 0 : slash + 1;
  return !name.empty() && full_name.substr(base) == name;
}

}  // namespace rips::ros2
