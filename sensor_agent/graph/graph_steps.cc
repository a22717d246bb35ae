// The sending half of GraphBuilder: what differs from what was sent, as numbered steps.
#include <algorithm>

#include "sensor_agent/graph/graph_builder.h"
#include "sensor_agent/outbox/outbox.h"

namespace rips::sensor {

namespace {

using ros2::Endpoint;
using ros2::EndpointKind;
using ros2::GraphDelta;
using ros2::Guid;
using ros2::Visibility;

// A name for a subscription that stands for whatever reader exists: in our prefix, entity kind
// "reader without key" (DDSI-RTPS 2.5 §9.3.1.2).
Guid ObserverGuid(const Guid& own, uint32_t number) {
  Guid guid = own;
  guid.bytes[12] = static_cast<uint8_t>(number >> 16);
  guid.bytes[13] = static_cast<uint8_t>(number >> 8);
  guid.bytes[14] = static_cast<uint8_t>(number);
  guid.bytes[15] = 0x04;
  return guid;
}

// Fills pieces of at most about `bytes`.
class Splitter {
 public:
  explicit Splitter(size_t bytes) : bytes_(bytes) {}

  GraphDelta& Room(size_t cost) {
    if (pieces_.empty() || used_ + cost > bytes_) {
      pieces_.emplace_back();
      used_ = 0;
    }
    used_ += cost;
    return pieces_.back();
  }
  std::vector<GraphDelta> Take() { return std::move(pieces_); }

 private:
  size_t bytes_;
  size_t used_ = 0;
  std::vector<GraphDelta> pieces_;
};

}  // namespace

std::vector<GraphDelta> SplitDelta(GraphDelta delta, size_t bytes) {
  std::vector<GraphDelta> pieces;
  if (CostOf(delta) <= bytes) {
    pieces.push_back(std::move(delta));
    return pieces;
  }
  std::optional<ros2::Truncation> truncation = std::move(delta.truncation);
  // What is new first, so that nothing names what is not there yet; what is gone last.
  Splitter splitter(bytes);
  const size_t item_bytes = CostOf(GraphDelta{.gone_guids = {Guid{}}});
  for (const ros2::Participant& each : delta.upsert_participants) {
    splitter.Room(CostOf(GraphDelta{.upsert_participants = {each}}))
        .upsert_participants.push_back(each);
  }
  for (const ros2::Node& each : delta.upsert_nodes) {
    splitter.Room(item_bytes + each.full_name.size()).upsert_nodes.push_back(each);
  }
  for (Endpoint& each : delta.upsert_endpoints) {
    const size_t cost = CostOf(each);
    splitter.Room(cost).upsert_endpoints.push_back(std::move(each));
  }
  for (const Guid& each : delta.gone_guids) splitter.Room(item_bytes).gone_guids.push_back(each);
  for (const std::string& name : delta.gone_nodes) {
    // Its survivors come back in the same piece.
    GraphDelta& piece = splitter.Room(item_bytes + name.size());
    piece.gone_nodes.push_back(name);
    for (const ros2::Node& each : delta.upsert_nodes) {
      if (each.full_name == name) piece.upsert_nodes.push_back(each);
    }
  }
  pieces = splitter.Take();
  if (truncation.has_value()) {
    // The graph is not whole before all of it is there.
    GraphDelta& piece = truncation->left_out > 0 ? pieces.front() : pieces.back();
    piece.truncation = *std::move(truncation);
  }
  return pieces;
}

int64_t GraphBuilder::NextDue() const {
  int64_t due = deadlines_.empty() ? kNever : deadlines_.begin()->first;
  if (!settled_) {
    return std::min(
        {due, last_discovery_ns_ + options_.settle_ns, start_ns_ + options_.settle_max_ns});
  }
  if (dirty_.empty()) return Told() == told_truncation_ ? due : burst_first_ns_;
  if (hurry_) return burst_first_ns_;
  return std::min(
      {due, last_discovery_ns_ + options_.quiet_ns, burst_first_ns_ + options_.burst_max_ns});
}

std::vector<GraphChange> GraphBuilder::Poll(int64_t now_ns) {
  EndGraces(now_ns);
  if (!settled_) {
    if (now_ns < last_discovery_ns_ + options_.settle_ns &&
        now_ns < start_ns_ + options_.settle_max_ns) {
      return {};
    }
    settled_ = true;
    std::vector<GraphChange> changes = Number(TakeDelta(), /*snapshot=*/true);
    EndVisits(now_ns);
    // At once: the snapshot shows a node that left beside the node that replaced it.
    if (GraphDelta over = TakeDelta(); !over.empty()) {
      for (GraphChange& change : Number(std::move(over), /*snapshot=*/false)) {
        changes.push_back(std::move(change));
      }
    }
    return changes;
  }
  if (dirty_.empty() && Told() == told_truncation_) return {};
  const bool burst = now_ns < last_discovery_ns_ + options_.quiet_ns &&
                     now_ns < burst_first_ns_ + options_.burst_max_ns;
  if (burst && !hurry_ && !dirty_.empty()) return {};
  GraphDelta delta = TakeDelta();
  EndVisits(now_ns);
  if (delta.empty()) return {};
  return Number(std::move(delta), /*snapshot=*/false);
}

std::vector<GraphChange> GraphBuilder::Snapshot(int64_t now_ns) {
  if (!settled_) return {};
  EndGraces(now_ns);
  TakeDelta();  // is in what was sent from here on
  GraphDelta all;
  for (const auto& [guid, state] : participants_) {
    if (!state.sent.has_value()) continue;
    all.upsert_participants.push_back(*state.sent);
    for (const std::string& node : state.sent_nodes) all.upsert_nodes.push_back({node, guid});
    for (const auto& [endpoint, sent] : state.sent_endpoints) all.upsert_endpoints.push_back(sent);
  }
  for (const auto& [topic, use] : topics_) {
    if (use.observer.has_value()) all.upsert_endpoints.push_back(*use.observer);
  }
  if (told_truncation_.left_out > 0) all.truncation = told_truncation_;
  EndVisits(now_ns);
  return Number(std::move(all), /*snapshot=*/true);
}

std::vector<GraphChange> GraphBuilder::Number(GraphDelta delta, bool snapshot) {
  std::vector<GraphChange> changes;
  for (GraphDelta& piece : SplitDelta(std::move(delta), options_.step_bytes)) {
    GraphChange change;
    change.from_version = snapshot && changes.empty() ? 0 : version_;
    change.to_version = ++version_;
    change.delta = std::move(piece);
    changes.push_back(std::move(change));
  }
  changes.back().settled = settled_;
  return changes;
}

GraphDelta GraphBuilder::TakeDelta() {
  GraphDelta delta;
  for (const Guid& guid : dirty_) {
    const auto it = participants_.find(guid);
    if (it == participants_.end()) continue;
    DiffParticipant(guid, it->second, delta);
    const ParticipantState& state = it->second;
    if (!state.present() && state.claims.nodes.empty() && state.claims.node_of.empty() &&
        state.visitors.empty()) {
      participants_.erase(it);
    }
  }
  dirty_.clear();
  hurry_ = false;
  if (ros2::Truncation now = Told(); now != told_truncation_) {
    delta.truncation = told_truncation_ = std::move(now);
  }
  DiffObserver(delta);
  std::sort(delta.gone_nodes.begin(), delta.gone_nodes.end());
  delta.gone_nodes.erase(std::unique(delta.gone_nodes.begin(), delta.gone_nodes.end()),
                         delta.gone_nodes.end());
  for (const std::string& name : delta.gone_nodes) {
    const auto owners = node_owners_.find(name);
    if (owners == node_owners_.end()) continue;
    for (const Guid& guid : owners->second) delta.upsert_nodes.push_back({name, guid});
  }
  std::sort(delta.upsert_nodes.begin(), delta.upsert_nodes.end());
  delta.upsert_nodes.erase(std::unique(delta.upsert_nodes.begin(), delta.upsert_nodes.end()),
                           delta.upsert_nodes.end());
  return delta;
}

void GraphBuilder::DiffParticipant(const Guid& guid, ParticipantState& state, GraphDelta& delta) {
  const bool own = IsOwn(guid);
  if (!state.present() || (own && options_.observer_hidden)) {
    if (!state.sent.has_value()) return;
    // Takes its nodes and endpoints along.
    delta.gone_guids.push_back(guid);
    for (const auto& [endpoint, sent] : state.sent_endpoints) CountTopic(sent, -1);
    for (const std::string& node : state.sent_nodes) {
      const auto owners = node_owners_.find(node);
      owners->second.erase(guid);
      if (owners->second.empty()) node_owners_.erase(owners);
    }
    state.sent.reset();
    state.sent_nodes.clear();
    state.sent_endpoints.clear();
    return;
  }
  ros2::Participant shown = state.facts;
  shown.authenticated = options_.secured && (guid == options_.own || !state.endpoints.empty() ||
                                             (state.sent && state.sent->authenticated));
  if (state.sent != shown) {
    delta.upsert_participants.push_back(shown);
    state.sent = std::move(shown);
  }
  absl::btree_set<std::string> nodes = state.claims.nodes;
  nodes.insert(state.visitors.begin(), state.visitors.end());
  DiffNodes(guid, state, own ? absl::btree_set<std::string>{kOwnNode} : std::move(nodes), delta);
  DiffEndpoints(state, delta);
}

void GraphBuilder::DiffNodes(const Guid& guid, ParticipantState& state,
                             absl::btree_set<std::string> nodes, GraphDelta& delta) {
  for (const std::string& node : state.sent_nodes) {
    if (nodes.contains(node)) continue;
    delta.gone_nodes.push_back(node);
    const auto owners = node_owners_.find(node);
    owners->second.erase(guid);
    if (owners->second.empty()) node_owners_.erase(owners);
  }
  for (const std::string& node : nodes) {
    if (state.sent_nodes.contains(node)) continue;
    delta.upsert_nodes.push_back({node, guid});
    node_owners_[node].insert(guid);
  }
  state.sent_nodes = std::move(nodes);
}

void GraphBuilder::DiffEndpoints(ParticipantState& state, GraphDelta& delta) {
  absl::btree_map<Guid, Endpoint>& sent = state.sent_endpoints;
  for (auto it = sent.begin(); it != sent.end();) {
    const auto now = state.endpoints.find(it->first);
    if (now != state.endpoints.end() && !now->second.hidden) {
      ++it;
      continue;
    }
    delta.gone_guids.push_back(it->first);
    CountTopic(it->second, -1);
    it = sent.erase(it);
  }
  for (auto& [guid, each] : state.endpoints) {
    if (each.hidden) continue;
    Endpoint now = Attributed(state, each);
    each.was_shown |= !now.pending;
    const auto it = sent.find(guid);
    if (it != sent.end() && it->second == now) continue;
    if (it != sent.end()) CountTopic(it->second, -1);
    CountTopic(now, 1);
    delta.upsert_endpoints.push_back(now);
    sent.insert_or_assign(guid, std::move(now));
  }
}

void GraphBuilder::CountTopic(const Endpoint& endpoint, int by) {
  const bool topic =
      endpoint.kind == EndpointKind::kPublisher || endpoint.kind == EndpointKind::kSubscriber;
  if (!topic || !endpoint.ros || endpoint.pending) return;
  TopicUse& use = topics_[endpoint.name];
  int& count = use.types[endpoint.type];
  count += by;
  if (count == 0) use.types.erase(endpoint.type);
  dirty_topics_.insert(endpoint.name);
}

void GraphBuilder::DiffObserver(GraphDelta& delta) {
  for (const std::string& topic : dirty_topics_) {
    const auto it = topics_.find(topic);
    if (it == topics_.end()) continue;
    TopicUse& use = it->second;
    const bool wanted = !use.types.empty() && Observes(topic) && !options_.observer_hidden;
    if (!wanted && use.observer.has_value()) {
      delta.gone_guids.push_back(use.observer->guid);
      use.observer.reset();
    }
    if (wanted && !use.observer.has_value()) {
      use.observer = Endpoint{.guid = ObserverGuid(options_.own, ++observer_entities_),
                              .kind = EndpointKind::kSubscriber,
                              .name = topic,
                              .node = kOwnNode,
                              .visibility = Visibility::kWatched};
    }
    if (wanted && use.observer->type != use.types.begin()->first) {
      use.observer->type = use.types.begin()->first;
      delta.upsert_endpoints.push_back(*use.observer);
    }
    if (use.types.empty()) topics_.erase(it);
  }
  dirty_topics_.clear();
}

}  // namespace rips::sensor
