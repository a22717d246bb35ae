#include "policy_server/server/robot/context/own_participants.h"

namespace rips::pipeline {

void OwnParticipants::Add(const ros2::Guid& participant, int64_t now_ns) {
  std::erase_if(known_, [&](const Known& each) { return each.guid == participant; });
  for (Known& each : known_) {
    if (each.until_ns == 0) each.until_ns = now_ns + kKeptNs;
  }
  known_.push_back({.guid = participant});
  if (known_.size() > kMax) known_.pop_front();
}

bool OwnParticipants::Expire(int64_t now_ns) {
  return std::erase_if(known_, [&](const Known& each) {
           return each.until_ns != 0 && now_ns >= each.until_ns;
         }) > 0;
}

void OwnParticipants::AppendTo(std::vector<ros2::Guid>& all) const {
  for (const Known& each : known_) all.push_back(each.guid);
}

std::optional<std::string> ForeignNodeOf(const ros2::RosGraph& graph,
                                         const ros2::Guid& participant) {
  for (const ros2::Node& node : graph.nodes()) {
    if (node.participant == participant && node.full_name != kRipsNode) return node.full_name;
  }
  return std::nullopt;
}

}  // namespace rips::pipeline
