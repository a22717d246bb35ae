// The limits of GraphBuilder: whose endpoints are held, and what is said of the rest.
#include <algorithm>
#include <iterator>
#include <utility>

#include "absl/numeric/bits.h"
#include "sensor_agent/graph/graph_builder.h"

namespace rips::sensor {

namespace {

using ros2::EndpointKind;
using ros2::Guid;

// At least as many, and for a growing number seldom another.
uint64_t RoundUp(uint64_t count) {
  constexpr uint64_t kRoundedMax = uint64_t{1} << 62;
  return absl::bit_ceil(std::min(count, kRoundedMax));
}

}  // namespace

bool GraphBuilder::IsKept(const ros2::Endpoint& shown) const {
  const bool topic =
      shown.kind == EndpointKind::kPublisher || shown.kind == EndpointKind::kSubscriber;
  return topic && shown.ros && kept_topics_ != nullptr && kept_topics_->contains(shown.name);
}

void GraphBuilder::SetKeptTopics(std::shared_ptr<const ros2::TopicNames> topics) {
  kept_topics_ = std::move(topics);
  for (auto& [guid, owner] : participants_) {
    for (auto& [endpoint, state] : owner.endpoints) {
      CountShare(owner, state, -1);
      state.kept = IsKept(state.shown);
      CountShare(owner, state, 1);
    }
  }
}

bool GraphBuilder::MakeRoom(const Guid& owner, bool hidden, bool kept, int64_t now_ns) {
  const ros2::GraphLimits& limits = options_.limits;
  const auto it = participants_.find(owner);
  const size_t hidden_held = it == participants_.end() ? 0 : it->second.hidden;
  const size_t shown_held = it == participants_.end() ? 0 : it->second.shown;
  if (hidden) {
    return hidden_held < limits.endpoints_per_participant && hidden_count_ < limits.endpoints;
  }
  if (shown_held >= limits.endpoints_per_participant) return kept && EvictFrom(owner, now_ns);
  if (shown_count_ >= limits.endpoints) return kept && EvictFromLargest(now_ns);
  return true;
}

bool GraphBuilder::EvictFromLargest(int64_t now_ns) {
  if (unkept_count_ == 0) return false;
  const auto largest = std::max_element(
      participants_.begin(), participants_.end(),
      [](const auto& a, const auto& b) { return a.second.unkept < b.second.unkept; });
  return EvictFrom(Guid(largest->first), now_ns);
}

bool GraphBuilder::EvictFrom(const Guid& participant, int64_t now_ns) {
  const auto owner = participants_.find(participant);
  if (owner == participants_.end() || owner->second.unkept == 0) return false;
  auto& endpoints = owner->second.endpoints;
  // The newest entity ids are likely to be those that filled the graph.
  for (auto it = endpoints.end(); it != endpoints.begin();) {
    --it;
    if (it->second.hidden || it->second.kept) continue;
    const Guid endpoint = it->first;
    LeaveOut(&owner->second, 1);
    leaving_.erase(endpoint);
    Remove(endpoint, now_ns);
    return true;
  }
  return false;
}

void GraphBuilder::CountShare(ParticipantState& owner, const EndpointState& state, int by) {
  const auto add = [by](size_t& count) { count += static_cast<size_t>(by); };
  add(state.hidden ? owner.hidden : owner.shown);
  add(state.hidden ? hidden_count_ : shown_count_);
  if (state.hidden || state.kept) return;
  add(owner.unkept);
  add(unkept_count_);
}

void GraphBuilder::LeaveOut(ParticipantState* of, uint64_t count) {
  counters_.dropped += count;
  truncation_.left_out += count;
  if (of != nullptr) of->left_out += count;
}

void GraphBuilder::EndTruncation() {
  truncation_ = {};
  for (auto& [guid, owner] : participants_) owner.left_out = 0;
}

ros2::Truncation GraphBuilder::Told() const {
  ros2::Truncation told;
  if (!truncated()) return told;
  told.left_out = RoundUp(truncation_.left_out);
  for (const auto& [guid, owner] : participants_) {
    if (owner.left_out == 0) continue;
    told.crowds.push_back({.participant = guid,
                           .endpoints = RoundUp(owner.shown),
                           .left_out = RoundUp(owner.left_out)});
  }
  KeepLargest(told.crowds);
  return told;
}

bool GraphBuilder::HasRoom() const {
  const ros2::GraphLimits& limits = options_.limits;
  const auto has_room = [](size_t size, size_t limit) { return size <= limit - limit / 8; };
  return has_room(participants_.size(), limits.participants) &&
         has_room(node_count_, limits.nodes) && has_room(shown_count_, limits.endpoints) &&
         std::all_of(participants_.begin(), participants_.end(), [&](const auto& entry) {
           return has_room(entry.second.shown, limits.endpoints_per_participant) &&
                  has_room(entry.second.claims.nodes.size() + entry.second.visitors.size(),
                           limits.nodes_per_participant);
         });
}

}  // namespace rips::sensor
