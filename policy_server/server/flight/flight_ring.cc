#include "policy_server/server/flight/flight_ring.h"

#include <algorithm>
#include <cstdint>
#include <utility>
#include <variant>

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

// Of its texts.
size_t BytesOf(const model::ExternalEvent& external) {
  return std::visit(Overloaded{[](const model::IdsAlert& ids) {
                                 return ids.source.size() + ids.message.size() + ids.src.size() +
                                        ids.dst.size() + ids.line.size();
                               },
                               [](const model::SignalSeen& seen) { return seen.name.size(); },
                               [](const model::AgentEvent& agent) {
                                 return agent.agent.size() + agent.state.size();
                               },
                               [](const model::Finding& finding) {
                                 return finding.kind.size() + finding.node.size() +
                                        finding.topic.size() + finding.detail.size();
                               },
                               [](const model::Loss& loss) {
                                 return loss.topic.size() + loss.type.size() + loss.cause.size();
                               },
                               [](const model::TickEvent&) { return size_t{0}; }},
                    external);
}

size_t BytesOf(const pipeline::Batch& batch) {
  return sizeof(batch) + batch.observations.size() * sizeof(pipeline::Observation) + batch.bytes +
         batch.payload_bytes;
}

namespace {

// Null if there is none, or more than one.
const ros2::GraphDelta* OnlyChange(const pipeline::Batch& batch) {
  const ros2::GraphDelta* only = nullptr;
  for (const pipeline::Observation& seen : batch.observations) {
    const auto* change = std::get_if<pipeline::GraphChange>(&seen.what);
    if (change == nullptr) continue;
    if (only != nullptr || change->whole()) return nullptr;
    only = &change->delta;
  }
  return only;
}

}  // namespace

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
  graph_ = newest_ = state.graph;
  // About as many as in the piece before.
  const size_t events = piece_ == nullptr ? 0 : piece_->events.size();
  piece_ = std::make_shared<FlightPiece>();
  piece_->events.reserve(events);
  piece_->state = std::move(state);
  piece_->graph_bytes = graph_bytes;
  piece_->began_ns = now.boottime_ns;
  taken_ = false;
  recent_senders_ = {};
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

FlightEvent& FlightRing::AddEvent(int64_t time_unix_ns) {
  RIPS_CHECK(piece_ != nullptr && !taken_, "a piece must have begun");
  piece().bytes += sizeof(FlightEvent);
  FlightEvent& event = piece().events.emplace_back();
  event.time_unix_ns = time_unix_ns;
  return event;
}

void FlightRing::AddOther(decltype(FlightOther::what) what, size_t bytes) {
  piece().bytes += sizeof(FlightOther) + bytes;
  piece().others.push_back({.event = piece().events.size() - 1, .what = std::move(what)});
}

void FlightRing::CountBatch(const std::shared_ptr<const pipeline::Batch>& batch) {
  // Null: a message before it had the same one, in the same piece.
  if (batch == nullptr || !piece().batches.insert(batch).second) return;
  piece().bytes += BytesOf(*batch);
}

const std::string* FlightRing::SenderOf(absl::string_view name) {
  // The names of one graph stay where they are; another name in that place has another text.
  const size_t hash = reinterpret_cast<uintptr_t>(name.data()) / 16 * 0x9e3779b97f4a7c15;
  const std::string*& recent = recent_senders_[hash >> 58];
  if (recent == nullptr || *recent != name) recent = &*piece().senders.emplace(name).first;
  return recent;
}

std::shared_ptr<const ros2::GraphDelta> FlightRing::DifferenceOf(
    const pipeline::JudgedEvent& judged) {
  // What a graph leaves out is not in the change that the sensor told of.
  if (graph_ == newest_ && judged.batch != nullptr && judged.graph->dropped() == 0) {
    const ros2::GraphDelta* told = OnlyChange(*judged.batch);
    if (told != nullptr && BytesOf(*told) <= kToldBytesMax) {
      CountBatch(judged.batch);
      return {judged.batch, told};
    }
  }
  return std::make_shared<const ros2::GraphDelta>(ros2::RosGraph::Diff(*graph_, *judged.graph));
}

void FlightRing::Add(const pipeline::JudgedEvent& judged) {
  const engine::Event& of = judged.event;
  // Written in place: a copy of what was just written makes the processor wait.
  FlightEvent& event = AddEvent(of.time_unix_ns);
  event.findings = judged.findings;
  event.blind = judged.blind;
  event.late = of.lateness == levels::Lateness::kLate;
  if (const auto* message = std::get_if<engine::MessageEvent>(&of.what)) {
    event.seen = judged.message;
    event.payload_bytes_max =
        static_cast<uint32_t>(std::min<size_t>(judged.payload_bytes_max, UINT32_MAX));
    event.sender = SenderOf(message->sender);
    piece().bytes += message->topic.size() + message->type.size() + message->sender.size();
    CountBatch(judged.batch);
  } else if (const auto* external = std::get_if<model::ExternalEvent>(&of.what)) {
    AddOther(*external, BytesOf(*external));
  } else {
    auto delta = DifferenceOf(judged);
    const size_t bytes = BytesOf(*delta);
    AddOther(std::move(delta), bytes);
    graph_ = newest_ = judged.graph;
  }
  if (judged.graph == graph_) return;
  const auto [bytes, fresh] = piece().context_bytes.try_emplace(judged.graph.get());
  if (fresh) bytes->second = BytesOf(*judged.graph);
  piece().bytes += bytes->second;
  piece().contexts.push_back({.event = piece().events.size() - 1, .graph = judged.graph});
  graph_ = judged.graph;
}

void FlightRing::Add(const pipeline::LevelChange& level) {
  AddEvent(level.time_unix_ns);
  AddOther(level, level.to.size() + level.cause.size());
}

Flight FlightRing::Take() {
  taken_ = true;
  Flight flight(whole_.begin(), whole_.end());
  flight.push_back(piece_);
  return flight;
}

}  // namespace rips::flight
