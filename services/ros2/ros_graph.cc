#include "services/ros2/ros_graph.h"

#include <algorithm>
#include <iterator>
#include <limits>

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

Guid HighestGuid(const Guid& participant) {
  Guid highest = participant;
  std::fill(highest.bytes.end() - 4, highest.bytes.end(), uint8_t{0xff});
  return highest;
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
    if (dropped_ == 0 && !has_participant(node.participant)) {
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
    if (dropped_ == 0 && !has_participant(participant)) {
      return absl::InvalidArgumentError(
          absl::StrCat("endpoint ", ToString(endpoint.guid), " is of an unknown participant"));
    }
    if (dropped_ == 0 && !endpoint.node.empty() && !has_node({endpoint.node, participant})) {
      return absl::InvalidArgumentError(absl::StrCat("endpoint ", ToString(endpoint.guid),
                                                     " names unknown node `",
                                                     Printable(endpoint.node), "`"));
    }
  }
  if (dropped_ > 0 || gone.nodes.empty()) return absl::OkStatus();
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
  if (delta.truncation.has_value()) {
    sender_ = *delta.truncation;
    KeepLargest(sender_.crowds);
  }
  for (const Guid& guid : delta.gone_guids) {
    RemoveParticipant(guid);
    RemoveEndpoint(guid);
  }
  for (const std::string& name : delta.gone_nodes) {
    const auto begin = nodes_.lower_bound(Node{name, Guid{}});
    auto end = begin;
    for (; end != nodes_.end() && end->full_name == name; ++end) --shares_[end->participant].nodes;
    nodes_.erase(begin, end);
  }
  for (const Participant& participant : delta.upsert_participants) {
    if (participants_.size() >= limits_.participants && !participants_.contains(participant.guid)) {
      LeaveOut(participant.guid);
      continue;
    }
    participants_[participant.guid] = participant;
  }
  for (const Node& node : delta.upsert_nodes) ApplyNode(node);
  for (const Endpoint& endpoint : delta.upsert_endpoints) ApplyEndpoint(endpoint);
  if (dropped_ == 0 || delta.gone_nodes.empty()) return absl::OkStatus();
  // A node that was to come back may have found no room.
  std::vector<Endpoint> orphans;
  for (const auto& [guid, endpoint] : endpoints_) {
    if (!endpoint.node.empty() && !nodes_.contains({endpoint.node, guid.Participant()})) {
      orphans.push_back(endpoint);
    }
  }
  for (Endpoint& orphan : orphans) ApplyEndpoint(std::move(orphan));
  return absl::OkStatus();
}

void RosGraph::Clear() {
  RosGraph empty(limits_);
  empty.kept_topics_ = std::move(kept_topics_);
  empty.observer_ = observer_;
  *this = std::move(empty);
}

void RosGraph::ApplyNode(const Node& node) {
  if (nodes_.contains(node)) return;
  const bool known = participants_.contains(node.participant);
  if (!known || nodes_.size() >= limits_.nodes ||
      shares_[node.participant].nodes >= limits_.nodes_per_participant) {
    return LeaveOut(node.participant);
  }
  ++shares_[node.participant].nodes;
  nodes_.insert(node);
}

void RosGraph::ApplyEndpoint(Endpoint endpoint) {
  RemoveEndpoint(endpoint.guid);
  const Guid participant = endpoint.guid.Participant();
  if (!participants_.contains(participant)) return LeaveOut(participant);
  if (!endpoint.node.empty() && !nodes_.contains({endpoint.node, participant})) {
    endpoint.node.clear();
    LeaveOut(participant);
  }
  if (!MakeRoom(participant, IsKept(endpoint)) || !Index(endpoint)) return LeaveOut(participant);
  CountEndpoint(endpoint, /*gone=*/false);
  const Guid guid = endpoint.guid;
  endpoints_.emplace(guid, std::move(endpoint));
}

bool RosGraph::IsKept(const Endpoint& endpoint) const {
  const bool topic =
      endpoint.kind == EndpointKind::kPublisher || endpoint.kind == EndpointKind::kSubscriber;
  return topic && endpoint.ros && kept_topics_ != nullptr && kept_topics_->contains(endpoint.name);
}

bool RosGraph::MakeRoom(const Guid& participant, bool kept) {
  const auto share = shares_.find(participant);
  const size_t held = share == shares_.end() ? 0 : share->second.endpoints;
  if (participant == observer_) return held < limits_.topics + kKeptTopicsMax;
  if (held >= limits_.endpoints_per_participant) return kept && EvictFrom(participant);
  if (counted_ >= limits_.endpoints) return kept && EvictFromLargest();
  return true;
}

bool RosGraph::EvictFromLargest() {
  if (unkept_ == 0) return false;
  const Guid* largest = nullptr;
  size_t most = 0;
  for (const auto& [participant, share] : shares_) {
    if (participant == observer_ || share.unkept < most || share.unkept == 0) continue;
    // The same choice in every process.
    if (share.unkept == most && !(participant < *largest)) continue;
    most = share.unkept;
    largest = &participant;
  }
  return largest != nullptr && EvictFrom(Guid(*largest));
}

bool RosGraph::EvictFrom(const Guid& participant) {
  if (shares_[participant].unkept == 0) return false;
  // The newest entity ids are likely to be those that filled the graph.
  auto at = endpoints_.upper_bound(HighestGuid(participant));
  while (at != endpoints_.begin()) {
    --at;
    if (!at->first.SamePrefix(participant)) break;
    if (IsKept(at->second)) continue;
    Erase(at);
    LeaveOut(participant);
    return true;
  }
  return false;
}

void RosGraph::LeaveOut(const Guid& participant) {
  ++dropped_;
  // Unknown ones are as many as anyone likes.
  if (participants_.contains(participant)) ++shares_[participant].left_out;
}

void RosGraph::CountEndpoint(const Endpoint& endpoint, bool gone) {
  const Guid participant = endpoint.guid.Participant();
  Share& share = shares_[participant];
  const size_t unkept = IsKept(endpoint) ? 0 : 1;
  const size_t counted = participant == observer_ ? 0 : 1;
  if (gone) {
    --share.endpoints;
    share.unkept -= unkept;
    counted_ -= counted;
    unkept_ -= unkept * counted;
  } else {
    ++share.endpoints;
    share.unkept += unkept;
    counted_ += counted;
    unkept_ += unkept * counted;
  }
}

void RosGraph::RecountEndpoints() {
  for (auto& [participant, share] : shares_) share.endpoints = share.unkept = 0;
  counted_ = unkept_ = 0;
  for (const auto& [guid, endpoint] : endpoints_) CountEndpoint(endpoint, /*gone=*/false);
}

void RosGraph::SetKeptTopics(std::shared_ptr<const TopicNames> topics) {
  if (kept_topics_ == topics) return;
  kept_topics_ = std::move(topics);
  RecountEndpoints();
}

void RosGraph::SetObserver(const Guid& participant) {
  if (observer_ == participant) return;
  observer_ = participant;
  RecountEndpoints();
}

uint64_t RosGraph::left_out() const {
  const uint64_t room = std::numeric_limits<uint64_t>::max() - dropped_;
  return dropped_ + std::min(sender_.left_out, room);
}

Truncation RosGraph::truncation() const {
  Truncation all{.left_out = left_out(), .crowds = sender_.crowds};
  if (dropped_ == 0) return all;
  for (const auto& [participant, share] : shares_) {
    if (share.left_out == 0) continue;
    const auto told = std::find_if(all.crowds.begin(), all.crowds.end(),
                                   [&guid = participant](const Truncation::Crowd& crowd) {
                                     return crowd.participant == guid;
                                   });
    if (told != all.crowds.end()) {
      told->left_out +=
          std::min(share.left_out, std::numeric_limits<uint64_t>::max() - told->left_out);
    } else {
      all.crowds.push_back(
          {.participant = participant, .endpoints = share.endpoints, .left_out = share.left_out});
    }
  }
  KeepLargest(all.crowds);
  return all;
}

bool RosGraph::HasRoom() const {
  const auto has_room = [](size_t size, size_t limit) { return size <= limit - limit / 8; };
  return has_room(participants_.size(), limits_.participants) &&
         has_room(nodes_.size(), limits_.nodes) && has_room(counted_, limits_.endpoints) &&
         has_room(topics_.size(), limits_.topics) &&
         std::all_of(shares_.begin(), shares_.end(), [&](const auto& entry) {
           const auto& [participant, share] = entry;
           return participant == observer_ ||
                  (has_room(share.endpoints, limits_.endpoints_per_participant) &&
                   has_room(share.nodes, limits_.nodes_per_participant));
         });
}

void RosGraph::RemoveParticipant(const Guid& guid) {
  if (participants_.erase(guid) == 0) return;
  for (auto node = nodes_.begin(); node != nodes_.end();) {
    node = node->participant == guid ? nodes_.erase(node) : std::next(node);
  }
  for (auto at = endpoints_.lower_bound(LowestGuid(guid));
       at != endpoints_.end() && at->first.SamePrefix(guid);) {
    at = Erase(at);
  }
  shares_.erase(guid);
}

void RosGraph::RemoveEndpoint(const Guid& guid) {
  const auto at = endpoints_.find(guid);
  if (at != endpoints_.end()) Erase(at);
}

absl::btree_map<Guid, Endpoint>::iterator RosGraph::Erase(
    absl::btree_map<Guid, Endpoint>::iterator at) {
  Unindex(at->second);
  CountEndpoint(at->second, /*gone=*/true);
  return endpoints_.erase(at);
}

bool RosGraph::Index(const Endpoint& endpoint) {
  if (!IsAnswered(endpoint)) return true;
  if (endpoint.kind == EndpointKind::kClient) return true;
  if (endpoint.kind == EndpointKind::kService) {
    ++services_of_node_[endpoint.node][endpoint.name];
    return true;
  }
  if (topics_.size() >= limits_.topics && !topics_.contains(endpoint.name) && !IsKept(endpoint)) {
    return false;
  }
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
  if (Truncation after = to.truncation(); after != from.truncation()) {
    delta.truncation = std::move(after);
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
