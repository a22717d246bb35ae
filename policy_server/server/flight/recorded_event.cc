#include "policy_server/server/flight/recorded_event.h"

#include <utility>
#include <variant>

#include "services/base/overloaded.h"

namespace rips::flight {

recording::RecordedGraph WholeGraph(const ros2::RosGraph& graph) {
  return {.content = ros2::RosGraph::Diff(ros2::RosGraph(), graph), .whole = true, .settled = true};
}

recording::RecordedMessage MessageOf(const pipeline::MessageSeen& seen, std::string sender,
                                     size_t payload_bytes_max) {
  recording::RecordedMessage message{.topic = std::string(seen.topic),
                                     .type = std::string(seen.type),
                                     .sender = std::move(sender),
                                     .writer = seen.writer,
                                     .payload = seen.payload.substr(0, payload_bytes_max),
                                     .size_bytes = seen.size_bytes};
  message.truncated = message.payload.size() < message.size_bytes;
  return message;
}

recording::RecordedLevel LevelOf(const pipeline::LevelChange& level) {
  return {.to = level.to, .cause = level.cause};
}

recording::Recorded EventConverter::Convert(const pipeline::JudgedEvent& judged,
                                            size_t payload_bytes_max) {
  recording::Recorded out{.time_unix_ns = judged.event.time_unix_ns,
                          .blind = judged.blind,
                          .findings = judged.findings,
                          .late = judged.event.lateness == levels::Lateness::kLate};
  if (findings_ == out.findings) out.findings.reset();
  findings_ = judged.findings;
  const bool whole = std::exchange(context_due_, false);
  std::visit(Overloaded{[&](const engine::MessageEvent& message) {
                          out.what = MessageOf(*judged.message, std::string(message.sender),
                                               payload_bytes_max);
                        },
                        [&](const engine::GraphEvent&) {
                          out.what =
                              whole ? WholeGraph(*judged.graph)
                                    : recording::RecordedGraph{
                                          .content = ros2::RosGraph::Diff(*graph_, *judged.graph),
                                          .settled = true};
                          graph_ = judged.graph;
                        },
                        [&](const model::ExternalEvent& external) { out.what = external; }},
             judged.event.what);
  const bool graph_event = std::holds_alternative<engine::GraphEvent>(judged.event.what);
  if (judged.graph != graph_ || (whole && !graph_event)) {
    out.context = WholeGraph(*judged.graph);
    graph_ = judged.graph;
  }
  return out;
}

recording::Recorded EventConverter::Convert(const pipeline::LevelChange& level) {
  recording::Recorded out{.time_unix_ns = level.time_unix_ns};
  out.what = LevelOf(level);
  return out;
}

}  // namespace rips::flight
