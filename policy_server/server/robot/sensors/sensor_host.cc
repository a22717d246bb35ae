#include "policy_server/server/robot/sensors/sensor_host.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::pipeline {

void SensorHost::BeginGraph(const ros2::GraphLimits& limits,
                            std::shared_ptr<const ros2::TopicNames> kept_topics) {
  graph = ros2::RosGraph(limits);
  graph.SetKeptTopics(std::move(kept_topics));
  graph_incarnation.clear();
  settled = false;
}

bool SensorHost::IsJudged(const SpooledRange& range) const {
  return sequences.Judged(range.incarnation, range.lane) >= range.last_sequence;
}

bool SensorHost::HasBacklog() const {
  return session && !std::all_of(session->spooled.begin(), session->spooled.end(),
                                 [this](const SpooledRange& range) { return IsJudged(range); });
}

void SensorHost::ForgetJudged() {
  if (!session) return;
  std::erase_if(session->spooled, [this](const SpooledRange& range) { return IsJudged(range); });
}

absl::Status SensorHost::ApplySnapshot(const std::string& incarnation,
                                       const GraphChange& snapshot) {
  ros2::RosGraph taken = graph;
  taken.Clear();
  if (absl::Status status = taken.Apply(snapshot.delta); !status.ok()) return status;
  graph = std::move(taken);
  graph_incarnation = incarnation;
  graph_version = snapshot.to_version;
  settled = snapshot.settled;
  return absl::OkStatus();
}

absl::Status SensorHost::ApplyDelta(const std::string& incarnation, const GraphChange& delta) {
  if (delta.to_version <= graph_version) return absl::OkStatus();
  if (delta.from_version != graph_version) {
    return absl::InvalidArgumentError(absl::StrCat(
        "graph delta starts at version ", delta.from_version, ", held is ", graph_version));
  }
  if (absl::Status status = graph.Apply(delta.delta); !status.ok()) return status;
  graph_incarnation = incarnation;
  graph_version = delta.to_version;
  settled = settled || delta.settled;
  return absl::OkStatus();
}

}  // namespace rips::pipeline
