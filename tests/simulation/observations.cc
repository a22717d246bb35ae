#include "tests/simulation/observations.h"

#include <string>
#include <variant>

#include "services/base/overloaded.h"

namespace rips::simulation {
namespace {

constexpr uint8_t kCamera = 1;
constexpr uint8_t kNavigator = 2;
constexpr uint8_t kIntruder = 9;

ros2::Guid ParticipantOf(uint8_t n) {
  ros2::Guid guid;
  guid.bytes = {1, 0x10, n, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1};
  return guid;
}

ros2::Endpoint WriterOf(uint8_t n, const std::string& node) {
  ros2::Guid guid = ParticipantOf(n);
  guid.bytes[14] = 2;
  guid.bytes[15] = 3;
  return {.guid = guid,
          .kind = ros2::EndpointKind::kPublisher,
          .name = "/cmd_vel",
          .type = "geometry_msgs/msg/Twist",
          .node = node,
          .visibility = ros2::Visibility::kWatched};
}

void AddNode(uint8_t n, const std::string& name, ros2::GraphDelta& graph) {
  graph.upsert_participants.push_back({.guid = ParticipantOf(n)});
  graph.upsert_nodes.push_back({.full_name = name, .participant = ParticipantOf(n)});
}

}  // namespace

ros2::GraphDelta GraphNow(bool intruder) {
  ros2::GraphDelta graph;
  AddNode(kCamera, "/camera", graph);
  AddNode(kNavigator, "/navigator", graph);
  graph.upsert_endpoints.push_back(WriterOf(kNavigator, "/navigator"));
  if (!intruder) return graph;
  AddNode(kIntruder, "/intruder", graph);
  graph.upsert_endpoints.push_back(WriterOf(kIntruder, "/intruder"));
  return graph;
}

std::shared_ptr<const sensor::MessageSource> SourceOf(bool intruder) {
  const uint8_t n = intruder ? kIntruder : kNavigator;
  const ros2::Endpoint writer = WriterOf(n, intruder ? "/intruder" : "/navigator");
  return std::make_shared<const sensor::MessageSource>(
      sensor::MessageSource{.topic = writer.name, .type = writer.type, .writer = writer});
}

pipeline::Observation ToServerObservation(const sensor::ControlObservation& seen) {
  pipeline::Observation to{.boottime_ns = seen.boottime_ns};
  std::visit(Overloaded{[&](const sensor::Loss& loss) {
                          to.what = model::Loss{.count = loss.count, .cause = "outbox shed"};
                        },
                        [&](const auto& same) { to.what = same; }},
             seen.what);
  return to;
}

pipeline::Observation ToServerObservation(const sensor::MessageSeen& seen) {
  // What the views show lives as long as the program.
  return {.boottime_ns = seen.boottime_ns,
          .what = pipeline::MessageSeen{.topic = "/cmd_vel",
                                        .type = "geometry_msgs/msg/Twist",
                                        .writer = seen.source->writer.guid,
                                        .size_bytes = seen.size_bytes,
                                        .graph_version = seen.graph_version}};
}

uint64_t ObservationId(const pipeline::Observation& seen) {
  if (const auto* message = std::get_if<pipeline::MessageSeen>(&seen.what)) {
    return message->size_bytes;
  }
  const auto* ids = std::get_if<pipeline::IdsAlert>(&seen.what);
  return ids == nullptr ? 0 : ids->sid;
}

}  // namespace rips::simulation
