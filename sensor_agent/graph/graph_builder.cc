#include "sensor_agent/graph/graph_builder.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"

namespace rips::sensor {

namespace {

using ros2::Endpoint;
using ros2::EndpointKind;
using ros2::Guid;
using ros2::Visibility;

// Partition names of one endpoint that are kept; ROS uses none.
constexpr size_t kPartitionsMax = 16;

std::string NameOrPlaceholder(std::string name) {
  return name.empty() ? std::string("(empty)") : name;
}

}  // namespace

GraphBuilder::GraphBuilder(GraphOptions options, int64_t start_ns)
    : options_(std::move(options)),
      start_ns_(start_ns),
      plan_(std::make_shared<WatchPlan>(WatchOptions{.unwatched = options_.unwatched})),
      last_discovery_ns_(start_ns) {
  ParticipantState* own = Obtain(options_.own);
  own->discovered = true;
  dirty_.insert(options_.own);
}

bool GraphBuilder::IsOwn(const Guid& participant) const {
  return participant == options_.own || own_participants_.contains(participant);
}

bool GraphBuilder::Observes(absl::string_view topic) const {
  return std::find(options_.unwatched.begin(), options_.unwatched.end(), topic) ==
         options_.unwatched.end();
}

GraphBuilder::ParticipantState* GraphBuilder::Obtain(const Guid& participant) {
  if (auto it = participants_.find(participant); it != participants_.end()) return &it->second;
  if (participants_.size() >= options_.limits.participants) {
    LeaveOut(nullptr, 1);
    return nullptr;
  }
  ParticipantState& state = participants_[participant];
  state.facts.guid = participant;
  state.generation = generation_;
  return &state;
}

GraphBuilder::EndpointState* GraphBuilder::FindState(const Guid& endpoint) {
  const auto owner = participants_.find(endpoint.Participant());
  if (owner == participants_.end()) return nullptr;
  const auto it = owner->second.endpoints.find(endpoint);
  return it == owner->second.endpoints.end() ? nullptr : &it->second;
}

void GraphBuilder::Touch(const Guid& participant, int64_t now_ns) {
  if (dirty_.empty()) burst_first_ns_ = now_ns;
  dirty_.insert(participant);
  last_discovery_ns_ = now_ns;
  ++revision_;
}

void GraphBuilder::Wait(EndpointState& state, int64_t now_ns) {
  state.pending_until_ns = now_ns + options_.attribution_grace_ns;
  deadlines_.emplace(state.pending_until_ns, state.shown.guid);
}

void GraphBuilder::ParticipantSeen(const ros2::Participant& participant, int64_t now_ns) {
  if (participant.guid != participant.guid.Participant()) return;  // no participant's GUID
  ParticipantState* state = Obtain(participant.guid);
  if (state == nullptr) return;
  state->generation = generation_;
  state->leaving = false;
  if (state->discovered && state->facts == participant) return;
  state->discovered = true;
  state->facts = participant;
  Touch(participant.guid, now_ns);
}

void GraphBuilder::ParticipantGone(const Guid& participant, int64_t now_ns) {
  const auto it = participants_.find(participant);
  if (participant == options_.own || it == participants_.end()) return;
  ParticipantState& state = it->second;
  if (Unseen(state)) {
    state.leaving = true;
    leaving_.insert(participant);
    if (!settled_) {
      for (auto each = state.endpoints.begin(); each != state.endpoints.end();) {
        if (state.IsClaimed(each->second)) {
          ++each;
          continue;
        }
        CountShare(state, each->second, -1);
        each = state.endpoints.erase(each);
      }
    }
  } else {
    Forget(participant);
  }
  Touch(participant, now_ns);
}

bool GraphBuilder::ParticipantState::IsClaimed(const EndpointState& endpoint) const {
  return !endpoint.visitor.empty() || claims.node_of.contains(endpoint.shown.guid);
}

bool GraphBuilder::Unseen(const ParticipantState& owner, EndpointState& state) const {
  if (state.was_shown || state.hidden || !state.shown.ros) return false;
  // All visits before discovery settled are in one snapshot: one without a node would stand beside
  // every message of that time.
  if (!settled_ && !owner.IsClaimed(state)) return false;
  state.pending_until_ns = 0;  // who knew its node has gone
  return true;
}

bool GraphBuilder::Unseen(ParticipantState& state) const {
  if (IsOwn(state.facts.guid)) return false;
  bool unseen =
      state.present() && (!state.visitors.empty() ||
                          !std::includes(state.sent_nodes.begin(), state.sent_nodes.end(),
                                         state.claims.nodes.begin(), state.claims.nodes.end()));
  for (auto& [guid, endpoint] : state.endpoints) unseen |= Unseen(state, endpoint);
  return unseen;
}

void GraphBuilder::EndVisits(int64_t now_ns) {
  for (const Guid& guid : std::exchange(leaving_, {})) {
    if (guid != guid.Participant()) {
      Remove(guid, now_ns);
      continue;
    }
    const auto it = participants_.find(guid);
    if (it == participants_.end()) continue;
    node_count_ -= it->second.visitors.size();
    it->second.visitors.clear();
    if (it->second.leaving) Forget(guid);
    Touch(guid, now_ns);
  }
}

void GraphBuilder::DropClaims(ParticipantState& state) {
  node_count_ -= state.claims.nodes.size();
  claim_count_ -= state.claims.node_of.size();
  state.claims.nodes.clear();
  state.claims.node_of.clear();
}

void GraphBuilder::Forget(const Guid& participant) {
  const auto it = participants_.find(participant);
  ParticipantState& state = it->second;
  for (const auto& [guid, each] : state.endpoints) CountShare(state, each, -1);
  state.endpoints.clear();
  state.left_out = 0;
  DropClaims(state);
  node_count_ -= state.visitors.size();
  state.visitors.clear();
  state.discovered = false;
  state.leaving = false;
  if (!state.sent.has_value()) participants_.erase(it);
}

void GraphBuilder::SetShown(EndpointState& state, const EndpointFact& fact) const {
  const ros2::DemangledTopic topic = ros2::DemangleTopic(fact.topic);
  state.hidden = topic.kind == ros2::DdsTopicKind::kServiceReply;
  Endpoint& shown = state.shown;
  shown.guid = fact.guid;
  shown.kind = ros2::KindOf(topic.kind, fact.writer);
  shown.name = NameOrPlaceholder(topic.name);
  shown.type = NameOrPlaceholder(ros2::DemangleType(fact.type));
  shown.ros = topic.kind != ros2::DdsTopicKind::kOther;
  shown.qos = fact.qos;
  if (shown.qos.partitions.size() > kPartitionsMax) shown.qos.partitions.resize(kPartitionsMax);
  for (std::string& partition : shown.qos.partitions) partition = ros2::Printable(partition);
  shown.why.clear();
  state.topic = topic.kind == ros2::DdsTopicKind::kTopic;
  state.kept = IsKept(shown);
  if (topic.kind == ros2::DdsTopicKind::kServiceRequest) {
    shown.visibility = Visibility::kNotVisible;
    shown.why = "requests are not read: one more reader would make clients wait for ever";
  } else if (!state.topic) {
    shown.visibility =
        fact.topic == ros2::kDiscoveryTopic ? Visibility::kWatched : Visibility::kNotNeeded;
  }
  SetVisibility(state);
}

void GraphBuilder::SetVisibility(EndpointState& state) const {
  if (!state.topic) return;
  Endpoint& shown = state.shown;
  shown.why.clear();
  if (!plan_->Of(shown.name, shown.type).messages) {
    shown.visibility = Visibility::kNotNeeded;
    state.not_visible_because.clear();
  } else if (state.not_visible_because.empty()) {
    shown.visibility = Visibility::kWatched;
  } else {
    shown.visibility = Visibility::kNotVisible;
    shown.why = state.not_visible_because;
  }
}

void GraphBuilder::SetPlan(std::shared_ptr<const WatchPlan> plan, int64_t now_ns) {
  plan_ = std::move(plan);
  for (auto& [guid, participant] : participants_) {
    bool changed = false;
    for (auto& [endpoint, state] : participant.endpoints) {
      const Visibility before = state.shown.visibility;
      SetVisibility(state);
      changed |= state.shown.visibility != before;
    }
    if (changed) Refresh(guid, now_ns);
  }
}

void GraphBuilder::Refresh(const Guid& participant, int64_t now_ns) {
  if (dirty_.empty()) burst_first_ns_ = now_ns;
  dirty_.insert(participant);
  ++revision_;
}

void GraphBuilder::EndpointSeen(const EndpointFact& endpoint, int64_t now_ns) {
  const Guid owner_guid = endpoint.guid.Participant();
  if (owner_guid == options_.own || owner_guid == endpoint.guid) return;
  EndpointState* known = FindState(endpoint.guid);
  if (known != nullptr) {
    known->generation = generation_;
    leaving_.erase(endpoint.guid);
    const Endpoint before = known->shown;
    ParticipantState& owner = participants_.find(owner_guid)->second;
    CountShare(owner, *known, -1);
    SetShown(*known, endpoint);
    CountShare(owner, *known, 1);
    if (!(known->shown == before)) Touch(owner_guid, now_ns);
    return;
  }
  EndpointState fresh;
  fresh.generation = generation_;
  SetShown(fresh, endpoint);
  if (!MakeRoom(owner_guid, fresh.hidden, fresh.kept, now_ns)) {
    const auto known_owner = participants_.find(owner_guid);
    // Of what is never shown, nothing is missing.
    if (!fresh.hidden) {
      LeaveOut(known_owner == participants_.end() ? nullptr : &known_owner->second, 1);
    }
    return;
  }
  ParticipantState* owner = Obtain(owner_guid);
  if (owner == nullptr) return;
  EndpointState& state = owner->endpoints[endpoint.guid];
  state = std::move(fresh);
  CountShare(*owner, state, 1);
  if (state.shown.ros && !owner->claims.node_of.contains(endpoint.guid)) Wait(state, now_ns);
  Touch(owner_guid, now_ns);
}

void GraphBuilder::EndpointGone(const Guid& endpoint, int64_t now_ns) {
  EndpointState* state = FindState(endpoint);
  if (state == nullptr) return;
  const ParticipantState& owner = participants_.find(endpoint.Participant())->second;
  if (!Unseen(owner, *state)) return Remove(endpoint, now_ns);
  leaving_.insert(endpoint);
  Touch(endpoint.Participant(), now_ns);
}

void GraphBuilder::Remove(const Guid& endpoint, int64_t now_ns) {
  const Guid owner_guid = endpoint.Participant();
  const auto owner = participants_.find(owner_guid);
  if (owner == participants_.end()) return;
  const auto state = owner->second.endpoints.find(endpoint);
  if (state == owner->second.endpoints.end()) return;
  CountShare(owner->second, state->second, -1);
  owner->second.endpoints.erase(state);
  Touch(owner_guid, now_ns);
  if (!owner->second.present()) Forget(owner_guid);
}

void GraphBuilder::TakeBack(ParticipantState& owner, const ParticipantState::Claims& before,
                            int64_t now_ns) {
  // False if there is no room for one more.
  const auto visits = [&](const std::string& node) {
    if (owner.claims.nodes.contains(node) || owner.visitors.contains(node)) return true;
    const ros2::GraphLimits& limits = options_.limits;
    if (node_count_ >= limits.nodes ||
        owner.claims.nodes.size() + owner.visitors.size() >= limits.nodes_per_participant) {
      LeaveOut(&owner, 1);
      return false;
    }
    owner.visitors.insert(node);
    ++node_count_;
    leaving_.insert(owner.facts.guid);
    return true;
  };
  for (const std::string& node : before.nodes) {
    if (!owner.sent_nodes.contains(node)) visits(node);
  }
  for (auto& [guid, state] : owner.endpoints) {
    if (!state.shown.ros || owner.claims.node_of.contains(guid)) continue;
    const auto claimed = before.node_of.find(guid);
    if (claimed != before.node_of.end()) {
      if (!state.was_shown && !state.hidden) state.visitor = claimed->second;
      if (!std::exchange(state.grace_renewed, true)) Wait(state, now_ns);
    }
    // A node that an endpoint names is in the same step, also one that is taken back only now.
    if (!state.was_shown && !state.visitor.empty() && !visits(state.visitor)) state.visitor.clear();
  }
}

absl::Status GraphBuilder::NodesClaimed(const Guid& writer, const ros2::ParticipantEntities& claim,
                                        int64_t now_ns) {
  const Guid participant = writer.Participant();
  if (claim.participant != participant) {
    ++counters_.foreign_claims;
    return absl::PermissionDeniedError(absl::StrCat("writer ", ToString(writer),
                                                    " claims nodes for participant ",
                                                    ToString(claim.participant), "; ignored"));
  }
  if (IsOwn(participant)) return absl::OkStatus();
  ParticipantState* state = Obtain(participant);
  if (state == nullptr) {
    LeaveOut(nullptr, claim.nodes.size());
    return absl::ResourceExhaustedError(
        absl::StrCat("more than ", options_.limits.participants, " participants; claim ignored"));
  }
  const ParticipantState::Claims before = state->claims;
  DropClaims(*state);
  const ros2::GraphLimits& limits = options_.limits;
  uint64_t foreign = 0;
  uint64_t dropped = 0;
  for (const ros2::NodeEntities& each : claim.nodes) {
    const std::string node = ros2::JoinNodeName(each.node_namespace, each.node_name);
    if (!state->claims.nodes.contains(node)) {
      if (node_count_ >= limits.nodes ||
          state->claims.nodes.size() >= limits.nodes_per_participant) {
        ++dropped;
        continue;
      }
      state->claims.nodes.insert(node);
      ++node_count_;
    }
    for (const std::vector<Guid>* list : {&each.readers, &each.writers}) {
      for (const Guid& guid : *list) {
        if (!guid.SamePrefix(participant)) {
          ++foreign;
        } else if (claim_count_ >= 2 * limits.endpoints ||
                   state->claims.node_of.size() / 2 >= limits.endpoints_per_participant) {
          ++dropped;
        } else if (state->claims.node_of.emplace(guid, node).second) {
          ++claim_count_;
        }
      }
    }
  }
  TakeBack(*state, before, now_ns);
  if (!state->present()) {
    state->orphan_until_ns = now_ns + options_.orphan_claim_ns;
    deadlines_.emplace(state->orphan_until_ns, participant);
  }
  Touch(participant, now_ns);
  counters_.foreign_claims += foreign;
  LeaveOut(state, dropped);
  if (foreign > 0) {
    return absl::PermissionDeniedError(absl::StrCat("writer ", ToString(writer), " lists ", foreign,
                                                    " endpoints of other participants; ignored"));
  }
  if (dropped > 0) {
    return absl::ResourceExhaustedError(
        absl::StrCat("more than ", limits.nodes, " nodes, or ", limits.nodes_per_participant,
                     " of one participant; ", dropped, " claims ignored"));
  }
  return absl::OkStatus();
}

void GraphBuilder::SetOwnParticipants(const std::vector<Guid>& participants, int64_t now_ns) {
  absl::btree_set<Guid> now(participants.begin(), participants.end());
  if (now == own_participants_) return;
  own_participants_.swap(now);
  for (const absl::btree_set<Guid>* set : {&now, &own_participants_}) {
    for (const Guid& guid : *set) {
      if (now.contains(guid) != own_participants_.contains(guid) && participants_.contains(guid)) {
        Touch(guid, now_ns);
      }
    }
  }
}

void GraphBuilder::SetNotVisible(const Guid& writer, const std::string& why, int64_t now_ns) {
  EndpointState* state = FindState(writer);
  if (state == nullptr || state->not_visible_because == why) return;
  state->not_visible_because = why;
  SetVisibility(*state);
  Refresh(writer.Participant(), now_ns);
}

void GraphBuilder::EndResync(int64_t now_ns) {
  std::vector<Guid> stale;
  std::vector<Guid> stale_endpoints;
  for (const auto& [guid, state] : participants_) {
    if (guid == options_.own) continue;
    if (state.generation != generation_) {
      stale.push_back(guid);
      continue;
    }
    for (const auto& [endpoint, each] : state.endpoints) {
      if (each.generation != generation_) stale_endpoints.push_back(endpoint);
    }
  }
  for (const Guid& guid : stale) ParticipantGone(guid, now_ns);
  for (const Guid& guid : stale_endpoints) EndpointGone(guid, now_ns);
}

void GraphBuilder::EndGraces(int64_t now_ns) {
  while (!deadlines_.empty() && deadlines_.begin()->first <= now_ns) {
    const Guid guid = deadlines_.begin()->second;
    deadlines_.erase(deadlines_.begin());
    const Guid owner_guid = guid.Participant();
    const auto owner = participants_.find(owner_guid);
    if (owner == participants_.end()) continue;
    if (guid == owner_guid) {
      if (!owner->second.present() && owner->second.orphan_until_ns <= now_ns) Forget(owner_guid);
      continue;
    }
    EndpointState* state = FindState(guid);
    if (state == nullptr || state->pending_until_ns == 0 || state->pending_until_ns > now_ns) {
      continue;
    }
    state->pending_until_ns = 0;
    if (owner->second.claims.node_of.contains(guid)) continue;
    Refresh(owner_guid, now_ns);
    hurry_ = true;
  }
}

Endpoint GraphBuilder::Attributed(const ParticipantState& owner, const EndpointState& state) const {
  Endpoint endpoint = state.shown;
  if (!endpoint.ros) return endpoint;
  if (IsOwn(owner.facts.guid)) {
    endpoint.node = kOwnNode;
  } else if (const auto it = owner.claims.node_of.find(endpoint.guid);
             it != owner.claims.node_of.end()) {
    endpoint.node = it->second;
  } else if (!state.was_shown && (owner.visitors.contains(state.visitor) ||
                                  owner.claims.nodes.contains(state.visitor))) {
    endpoint.node = state.visitor;
  } else {
    endpoint.pending = state.pending_until_ns != 0;
  }
  return endpoint;
}

std::optional<Endpoint> GraphBuilder::Find(const Guid& endpoint) const {
  const auto owner = participants_.find(endpoint.Participant());
  if (owner == participants_.end()) return std::nullopt;
  const auto it = owner->second.endpoints.find(endpoint);
  if (it == owner->second.endpoints.end() || it->second.hidden) return std::nullopt;
  return Attributed(owner->second, it->second);
}

std::optional<uint64_t> GraphBuilder::VersionShowing(const Guid& endpoint) const {
  const std::optional<Endpoint> now = Find(endpoint);
  if (!now.has_value()) return std::nullopt;
  const absl::btree_map<Guid, Endpoint>& sent =
      participants_.find(endpoint.Participant())->second.sent_endpoints;
  const auto it = sent.find(endpoint);
  const bool shown = it != sent.end() && it->second.node == now->node &&
                     it->second.pending == now->pending && it->second.name == now->name &&
                     it->second.type == now->type;
  return shown ? version_ : version_ + 1;
}

}  // namespace rips::sensor
