#include "policy_server/server/robot/actuators/level_witness.h"

#include <algorithm>
#include <iterator>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {

bool IsSpared(absl::string_view topic) {
  constexpr absl::string_view kTopics[] = {"/rosout", "/parameter_events", "/diagnostics", "/bond"};
  return std::find(std::begin(kTopics), std::end(kTopics), topic) != std::end(kTopics) ||
         absl::EndsWith(topic, "/transition_event") || absl::StrContains(topic, "/_action/");
}

bool LevelWitness::SetParts(const std::string& host, const model::ActuatorHello& hello) {
  Parts& parts = parts_[host];
  parts.inactive.clear();
  for (const model::InactiveParts& each : hello.inactive_parts) {
    parts.inactive[each.level] = each.parts;
  }
  parts.topics = hello.published_while_inactive;
  return !parts.inactive.empty();
}

void LevelWitness::Update(const DecisionId& decision_id, const std::string& level,
                          absl::Span<const Holder> holders, int64_t now_ns) {
  const bool same = decision_id == decision_id_ &&
                    std::equal(holders.begin(), holders.end(), holders_.begin(), holders_.end(),
                               [](const Holder& holder, const auto& known) {
                                 return holder.host == known.first && holder.level == known.second;
                               });
  if (same) return;
  End();
  decision_id_ = decision_id;
  level_ = level;
  since_ns_ = now_ns;
  for (const Holder& holder : holders) {
    holders_.emplace_back(holder.host, holder.level);
    const Parts& parts = parts_[std::string(holder.host)];
    const auto decided = parts.inactive.find(level);
    const auto held = parts.inactive.find(holder.level);
    if (decided == parts.inactive.end() || held == parts.inactive.end()) continue;
    for (const std::string& node : decided->second) {
      const std::vector<std::string>& also = held->second;
      if (std::find(also.begin(), also.end(), node) != also.end()) silent_.insert(node);
    }
    spared_.insert(parts.topics.begin(), parts.topics.end());
  }
}

void LevelWitness::End() {
  if (decision_id_.none()) return;
  decision_id_ = {};
  holders_.clear();
  silent_.clear();
  spared_.clear();
  writers_.clear();
  contradiction_.clear();
}

void LevelWitness::BeginAgain(int64_t now_ns) {
  since_ns_ = now_ns;
  writers_.clear();
}

void LevelWitness::OnMessage(const Sent& sent, int64_t now_ns) {
  if (sent.taken_ns - since_ns_ <= kGraceNs) return;
  if (IsSpared(sent.topic) || spared_.contains(sent.topic)) return;
  heard_ns_ = now_ns;
  if (!contradiction_.empty()) return;
  std::pair<std::string, ros2::Guid> key(sent.node, sent.writer);
  if (writers_.size() >= kWritersMax && !writers_.contains(key)) key.second = {};
  const auto [it, fresh] =
      writers_.try_emplace(std::move(key), Taken{sent.taken_ns, sent.taken_ns});
  Taken& taken = it->second;
  if (sent.taken_ns - taken.last_ns > kPauseNs) taken.first_ns = sent.taken_ns;
  taken.last_ns = std::max(taken.last_ns, sent.taken_ns);
  if (taken.last_ns - taken.first_ns < kApartNs) return;
  contradiction_ =
      absl::StrCat("node ", ros2::Printable(sent.node), " publishes ", ros2::Printable(sent.topic),
                   " (writer ", ToString(sent.writer), "), and ", level_, " has it inactive");
}

void LevelWitness::OnTime(bool seen, int64_t now_ns) {
  if (contradiction_.empty()) return;
  if (!seen) heard_ns_ = now_ns;
  if (now_ns - heard_ns_ < kSilentNs) return;
  contradiction_.clear();
  writers_.clear();
}

}  // namespace rips::pipeline
