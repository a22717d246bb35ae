#include "policy_server/server/robot/model/coverage.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {

bool NeverRead(const ros2::Endpoint& endpoint) {
  return endpoint.kind == ros2::EndpointKind::kService ||
         endpoint.kind == ros2::EndpointKind::kClient;
}

EndpointCounts CountEndpoints(const ros2::RosGraph& graph,
                              const std::vector<ros2::Guid>& own_participants) {
  EndpointCounts counts;
  for (const auto& [guid, endpoint] : graph.endpoints()) {
    if (NeverRead(endpoint)) continue;
    if (std::find(own_participants.begin(), own_participants.end(), guid.Participant()) !=
        own_participants.end()) {
      continue;
    }
    switch (endpoint.visibility) {
      case ros2::Visibility::kWatched:
        ++counts.watched;
        break;
      case ros2::Visibility::kNotNeeded:
        ++counts.not_needed;
        break;
      case ros2::Visibility::kNotVisible:
      case ros2::Visibility::kUnspecified:
        ++counts.not_visible;
        break;
    }
  }
  return counts;
}

void CoverageAlarm::SetKinds(const std::string& host, const std::vector<std::string>& kinds) {
  const bool first = !kinds_.contains(host);
  Kinds& of_host = kinds_[host];
  of_host.now.clear();
  for (const std::string& kind : kinds) {
    if (of_host.now.size() >= kKindsMax) break;
    of_host.now.insert(ros2::Printable(kind.substr(0, kKindBytesMax)));
  }
  if (first) of_host.told = of_host.now;
}

std::optional<std::string> CoverageAlarm::Due(int64_t now_ns) {
  // What is seen again may be told again.
  told_not_visible_ = std::min(told_not_visible_, not_visible_);
  std::vector<std::string> fallen;
  for (auto& [host, kinds] : kinds_) {
    for (auto it = kinds.told.begin(); it != kinds.told.end();) {
      it = kinds.now.contains(*it) ? std::next(it) : kinds.told.erase(it);
    }
    std::vector<std::string> fresh;
    std::set_difference(kinds.now.begin(), kinds.now.end(), kinds.told.begin(), kinds.told.end(),
                        std::back_inserter(fresh));
    if (!fresh.empty()) {
      fallen.push_back(absl::StrCat("sensor ", host, " does not see ", absl::StrJoin(fresh, ", ")));
    }
  }
  if (not_visible_ > told_not_visible_) {
    fallen.insert(fallen.begin(), absl::StrCat(not_visible_, " endpoints are not visible, ",
                                               told_not_visible_, " were"));
  }
  if (fallen.empty() || (told_ns_.has_value() && now_ns - *told_ns_ < kEveryNs)) {
    return std::nullopt;
  }
  told_ns_ = now_ns;
  told_not_visible_ = not_visible_;
  for (auto& [host, kinds] : kinds_) kinds.told = kinds.now;
  return absl::StrJoin(fallen, "; ");
}

void CutPayloads::Add(absl::string_view topic, uint32_t came_bytes, uint32_t size_bytes,
                      int64_t now_ns) {
  auto it = topics_.find(topic);
  if (it == topics_.end() && topics_.size() >= kTopicsMax) {
    topics_.erase(std::min_element(
        topics_.begin(), topics_.end(),
        [](const auto& a, const auto& b) { return a.second.last_ns < b.second.last_ns; }));
  }
  if (it == topics_.end()) it = topics_.emplace(topic, Topic{.topic = std::string(topic)}).first;
  Topic& cut = it->second;
  if (now_ns - cut.last_ns > kKeptNs) cut = {.topic = std::move(cut.topic)};
  cut.limit_bytes = came_bytes;
  cut.longest_bytes = std::max(cut.longest_bytes, size_bytes);
  ++cut.count;
  cut.last_ns = now_ns;
}

std::vector<CutPayloads::Topic> CutPayloads::Recent(int64_t now_ns) const {
  std::vector<Topic> recent;
  for (const auto& [name, topic] : topics_) {
    if (now_ns - topic.last_ns <= kKeptNs) recent.push_back(topic);
  }
  return recent;
}

}  // namespace rips::pipeline
