#include "policy_server/server/operator_api/record_tap.h"

#include <memory>
#include <string>
#include <utility>
#include <variant>

#include "services/model_proto/observation_codec.h"
#include "services/ros2_proto/graph_codec.h"

namespace rips::operator_api {
namespace {

using rips::v1::RecordedEvent;

void Fill(const engine::MessageEvent& message, const pipeline::JudgedEvent& judged,
          rips::v1::RecordedMessage* out) {
  const pipeline::MessageSeen* seen = judged.message;
  out->set_topic(std::string(message.topic));
  out->set_type(std::string(message.type));
  out->set_sender(std::string(message.sender));
  if (!message.writer.none()) out->set_writer_guid(message.writer.ToBytes());
  out->set_size_bytes(message.size_bytes);
  if (seen != nullptr) out->set_payload(seen->payload.substr(0, judged.payload_bytes_max));
  out->set_truncated(out->payload().size() < message.size_bytes);
}

}  // namespace

void RecordingWriter::Start(rips::v1::RecordingHeader header,
                            std::shared_ptr<const ros2::RosGraph> graph, bool settled) {
  graph_ = std::move(graph);
  rips::v1::Recording first;
  const int64_t start_unix_ns = header.start_unix_ns();
  *first.mutable_header() = std::move(header);
  if (!send_(std::move(first)) || !settled) return;
  rips::v1::Recording second;
  RecordedEvent* event = second.mutable_event();
  event->set_time_unix_ns(start_unix_ns);
  event->mutable_snapshot()->set_settled(true);
  ros2_proto::EncodeGraph(*graph_, *event->mutable_snapshot());
  send_(std::move(second));
}

bool RecordingWriter::OnLevel(const pipeline::LevelChange& level) {
  rips::v1::Recording piece;
  RecordedEvent* out = piece.mutable_event();
  out->set_time_unix_ns(level.time_unix_ns);
  out->mutable_level()->set_to(level.to);
  out->mutable_level()->set_cause(level.cause);
  return send_(std::move(piece));
}

bool RecordingWriter::OnEvent(const pipeline::JudgedEvent& judged) {
  const engine::Event& event = judged.event;
  const std::shared_ptr<const ros2::RosGraph>& graph = judged.graph;
  rips::v1::Recording piece;
  RecordedEvent* out = piece.mutable_event();
  out->set_time_unix_ns(event.time_unix_ns);
  out->set_blind(judged.blind);
  out->set_late(event.lateness == levels::Lateness::kLate);
  if (const auto* sample = std::get_if<engine::MessageEvent>(&event.what)) {
    Fill(*sample, judged, out->mutable_message());
  } else if (std::holds_alternative<engine::GraphEvent>(event.what)) {
    out->mutable_delta()->set_settled(true);
    ros2_proto::EncodeGraph(ros2::RosGraph::Diff(*graph_, *graph), *out->mutable_delta());
    graph_ = graph;
  } else if (!model_proto::Encode(std::get<model::ExternalEvent>(event.what), *out)) {
    return listening_();
  }
  if (graph != graph_) {
    // A message that was taken under an earlier graph, or what comes after it.
    out->mutable_context()->set_settled(true);
    ros2_proto::EncodeGraph(*graph, *out->mutable_context());
    graph_ = graph;
  }
  return send_(std::move(piece));
}

}  // namespace rips::operator_api
