#include "policy_server/server/flight/flight_ring.h"

#include <utility>

#include "policy_server/policy/levels/level_machine.h"
#include "services/base/check.h"
#include "services/base/overloaded.h"

namespace rips::flight {
namespace {

// A participant, node or endpoint with its names, about.
constexpr size_t kGraphEntryBytes = 256;

size_t BytesOf(const ros2::GraphDelta& delta) {
  return kGraphEntryBytes *
         (1 + delta.upsert_participants.size() + delta.upsert_nodes.size() +
          delta.upsert_endpoints.size() + delta.gone_guids.size() + delta.gone_nodes.size());
}

}  // namespace

size_t BytesOf(const model::ExternalEvent& external) {
  const size_t texts = std::visit(
      Overloaded{
          [](const model::IdsAlert& ids) {
            return ids.source.size() + ids.message.size() + ids.src.size() + ids.dst.size() +
                   ids.line.size();
          },
          [](const model::SignalSeen& seen) { return seen.name.size(); },
          [](const model::AgentEvent& agent) { return agent.agent.size() + agent.state.size(); },
          [](const model::Finding& finding) {
            return finding.kind.size() + finding.node.size() + finding.topic.size() +
                   finding.detail.size();
          },
          [](const model::Loss& loss) {
            return loss.topic.size() + loss.type.size() + loss.cause.size();
          },
          [](const model::TickEvent&) { return size_t{0}; }},
      external);
  return sizeof(external) + texts;
}

size_t BytesOf(const pipeline::Batch& batch) {
  return sizeof(batch) + batch.observations.size() * sizeof(pipeline::Observation) + batch.bytes +
         batch.payload_bytes;
}

size_t BytesOf(const ros2::RosGraph& graph) {
  size_t bytes = 64 * (1 + graph.participants().size());
  for (const auto& [guid, participant] : graph.participants()) bytes += participant.host.size();
  for (const ros2::Node& node : graph.nodes()) bytes += 64 + node.full_name.size();
  for (const auto& [guid, endpoint] : graph.endpoints()) {
    bytes += 64 + endpoint.name.size() + endpoint.type.size() + endpoint.node.size();
  }
  return bytes;
}

void FlightRing::Begin(pipeline::RulesState state, Instant now) {
  if (piece_ != nullptr && piece_->state.bundle_id != state.bundle_id) {
    whole_.clear();
  } else if (piece_ != nullptr && !piece_->events.empty()) {
    whole_.push_back(piece_);
  }
  const bool same_graph = piece_ != nullptr && piece_->state.graph == state.graph;
  const size_t graph_bytes = same_graph ? piece_->graph_bytes : BytesOf(*state.graph);
  graph_ = state.graph;
  piece_ = std::make_shared<FlightPiece>();
  piece_->state = std::move(state);
  piece_->graph_bytes = graph_bytes;
  piece_->began_ns = now.boottime_ns;
  taken_ = false;
  DropOld(now);
}

bool FlightRing::wants_piece(Instant now) const {
  return taken_ || piece_->bytes >= kPieceBytes || now.boottime_ns - piece_->began_ns >= kPieceNs;
}

void FlightRing::DropOld(Instant now) {
  while (!whole_.empty()) {
    const int64_t end_ns = whole_.size() > 1 ? whole_[1]->began_ns : piece_->began_ns;
    if (bytes() <= kBytesMax && now.boottime_ns - end_ns < kSpanNs) return;
    whole_.pop_front();
  }
}

size_t FlightRing::bytes() const {
  if (piece_ == nullptr) return 0;
  size_t bytes = piece_->bytes;
  for (const auto& each : whole_) bytes += each->bytes;
  // The graph at the start is written out; those of later pieces are not.
  const FlightPiece& first = whole_.empty() ? *piece_ : *whole_.front();
  return bytes + first.graph_bytes;
}

FlightEvent& FlightRing::AddEvent(int64_t time_unix_ns, size_t bytes) {
  RIPS_CHECK(piece_ != nullptr && !taken_, "a piece must have begun");
  piece().bytes += sizeof(FlightEvent) + bytes;
  FlightEvent& event = piece().events.emplace_back();
  event.time_unix_ns = time_unix_ns;
  return event;
}

void FlightRing::Add(const pipeline::JudgedEvent& judged) {
  const engine::Event& of = judged.event;
  FlightEvent& event = AddEvent(of.time_unix_ns, 0);
  event.blind = judged.blind;
  event.late = of.lateness == levels::Lateness::kLate;
  std::visit(Overloaded{[&](const engine::MessageEvent& message) {
                          const auto [sender, fresh] = piece().senders.emplace(message.sender);
                          event.what = FlightMessage{.seen = judged.message,
                                                     .sender = &*sender,
                                                     .batch = judged.batch,
                                                     .payload_bytes_max = judged.payload_bytes_max};
                          piece().bytes +=
                              message.topic.size() + message.type.size() + message.sender.size();
                          const bool counted = !piece().batches.insert(judged.batch.get()).second;
                          if (!counted && judged.batch != nullptr)
                            piece().bytes += BytesOf(*judged.batch);
                        },
                        [&](const engine::GraphEvent&) {
                          auto delta = std::make_unique<const ros2::GraphDelta>(
                              ros2::RosGraph::Diff(*graph_, *judged.graph));
                          piece().bytes += BytesOf(*delta);
                          event.what = std::move(delta);
                          graph_ = judged.graph;
                        },
                        [&](const model::ExternalEvent& external) {
                          piece().bytes += BytesOf(external);
                          event.what = std::make_unique<const model::ExternalEvent>(external);
                        }},
             of.what);
  if (judged.graph != graph_) {
    const auto [bytes, fresh] = piece().context_bytes.try_emplace(judged.graph.get());
    if (fresh) bytes->second = BytesOf(*judged.graph);
    piece().bytes += bytes->second;
    event.context = judged.graph;
    graph_ = judged.graph;
  }
}

void FlightRing::Add(const pipeline::LevelChange& level) {
  AddEvent(level.time_unix_ns, level.to.size() + level.cause.size() + sizeof(level)).what =
      std::make_unique<const pipeline::LevelChange>(level);
}

Flight FlightRing::Take() {
  taken_ = true;
  Flight flight(whole_.begin(), whole_.end());
  flight.push_back(piece_);
  return flight;
}

}  // namespace rips::flight
