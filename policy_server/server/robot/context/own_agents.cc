#include "policy_server/server/robot/context/own_agents.h"

#include <utility>

#include "absl/container/btree_set.h"
#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {

std::string OwnAgents::FullName(const std::string& agent) const {
  const size_t space = agent.find(' ');
  return absl::StrCat(agent.substr(0, space + 1), context_.config.id, "/", agent.substr(space + 1));
}

void OwnAgents::AddParticipant(const std::string& agent, const ros2::Guid& participant) {
  if (participant.none()) return;
  if (const auto node = ForeignNodeOf(graph_.get(), participant)) {
    return alerts_.Raise(
        engine::Severity::kCritical,
        absl::StrCat(agent, " calls the DDS participant of node ", ros2::Printable(*node),
                     " its own; that is not believed, and its key may be in other hands"));
  }
  agents_[agent].participants.Add(participant, context_.now_ns());
}

bool OwnAgents::Expire() {
  bool expired = false;
  for (auto& [name, agent] : agents_) expired |= agent.participants.Expire(context_.now_ns());
  return expired;
}

std::vector<ros2::Guid> OwnAgents::participants() const {
  std::vector<ros2::Guid> all;
  for (const auto& [name, agent] : agents_) agent.participants.AppendTo(all);
  return all;
}

void OwnAgents::SetParts(const std::string& agent, std::vector<std::string> parts) {
  agents_[agent].parts = std::move(parts);
}

bool OwnAgents::HasParts(const std::string& agent) const {
  const auto it = agents_.find(agent);
  return it != agents_.end() && !it->second.parts.empty();
}

std::vector<std::string> OwnAgents::parts() const {
  absl::btree_set<std::string> all;
  for (const auto& [name, agent] : agents_) all.insert(agent.parts.begin(), agent.parts.end());
  return {all.begin(), all.end()};
}

void OwnAgents::OnSession(const std::string& agent, const std::string& peer) {
  const std::string before = agents_[agent].second.Begin(peer, context_.now_ns());
  if (before.empty()) return;
  alerts_.Raise(engine::Severity::kMedium,
                absl::StrCat(FullName(agent), " now comes from ", peer, ", before from ", before,
                             "; if it was not moved, its key may be in other hands"));
}

void OwnAgents::OnRefused(const std::string& agent, const std::string& peer) {
  agents_[agent].second.Refused(peer, context_.now_ns());
  context_.Count(Counter::kSessionsRefused);
}

void OwnAgents::OnHeard(const std::string& agent) {
  const auto it = agents_.find(agent);
  if (it == agents_.end()) return;
  const auto report = it->second.second.Heard(context_.now_ns());
  if (!report) return;
  alerts_.Raise(engine::Severity::kCritical,
                absl::StrCat("a second process uses the key of ", FullName(agent), ": refused ",
                             report->refused, " times, last from ", report->peer,
                             "; the session in use is from ", report->holder,
                             "; find out which of them is the robot, and replace the key"));
}

void OwnAgents::OnMisused(const std::string& agent, const std::string& peer) {
  SecondHolder& second = agents_[agent].second;
  if (!second.Misused(context_.now_ns())) return;
  alerts_.Raise(
      engine::Severity::kCritical,
      absl::StrCat("the key of ", FullName(agent), " is used from ", peer,
                   " for what no agent of RIPS does",
                   second.holder().empty()
                       ? std::string("; it has had no session yet")
                       : absl::StrCat("; its session is, or was last, from ", second.holder()),
                   "; find out which of them is the robot, and replace the key"));
}

std::string OwnAgents::DoubtOf(const std::string& agent) const {
  const auto it = agents_.find(agent);
  if (it == agents_.end()) return "";
  switch (it->second.second.DoubtAt(context_.now_ns())) {
    case SecondHolder::Doubt::kSecond:
      return absl::StrCat("a second process uses the key of ", agent);
    case SecondHolder::Doubt::kMisused:
      return absl::StrCat("the key of ", agent, " is used for what no agent does");
    case SecondHolder::Doubt::kMoved:
      return absl::StrCat(agent, " came from another address less than ",
                          SecondHolder::kMovedNs / kNanosPerSecond, " s ago");
    case SecondHolder::Doubt::kNone:
      break;
  }
  return "";
}

}  // namespace rips::pipeline
