// Robot: the control lane. A batch is judged in order, as far as a turn lasts; the rest follows in
// the robot's next turns.
#include <algorithm>
#include <utility>

#include "policy_server/server/robot/robot.h"

namespace rips::pipeline {
namespace {

// A turn ends after the graph, or the kPieceMax other observations, during which it has lasted so
// long.
constexpr int64_t kControlTurnNs = 2 * kNanosPerMilli;
constexpr size_t kPieceMax = 32;
// Graphs of one batch that are judged by an event each, and one more for every 20 ms of the
// sensor's time before: a sensor waits for 20 ms of quiet before it tells of a change
// (graph_builder.h), so an honest one, with a backlog too, never exceeds this. Beyond it, changes
// are taken one by one and judged together.
constexpr size_t kGraphsJudgedMax = 4;
constexpr uint64_t kSensorQuietNs = 20 * kNanosPerMilli;

// Up to where the batch is judged in one piece.
size_t EndOfPiece(const Batch& batch, size_t from) {
  const size_t end = std::min(batch.observations.size(), from + kPieceMax);
  size_t to = from;
  while (to < end && !IsGraph(batch.observations[to])) ++to;
  return to < end ? to + 1 : end;
}

}  // namespace

void Robot::Advance() {
  if (HasControl()) return AdvanceControl();
  AdvanceMessages();
}

void Robot::AdvanceControl() {
  const int64_t end_ns = ports_.clock->Now().boottime_ns + kControlTurnNs;
  while (!control_line_.batches.empty()) {
    ControlBatch& first = control_line_.batches.front();
    const size_t size = first.batch->observations.size();
    while (first.judged < size && SessionOf(first.host, first.link.get()) != nullptr) {
      const size_t to = EndOfPiece(*first.batch, first.judged);
      JudgeBatch(first.host, first.link.get(), *first.batch, first.judged, to, {});
      first.judged = to;
      if (to < size && ports_.clock->Now().boottime_ns >= end_ns) return;
    }
    // What a stream that has ended leaves here was not acknowledged and will be sent again; a
    // graph that was taken will not.
    JudgeMerged(first);
    control_line_.batches.pop_front();
    if (ports_.clock->Now().boottime_ns >= end_ns) break;
  }
  // The graph that they wait for may have come.
  AdvanceMessages();
}

bool Robot::MergesGraph(const Batch& batch, const engine::Event& event, int64_t boottime_ns) {
  if (control_line_.batches.empty()) return false;
  ControlBatch& first = control_line_.batches.front();
  const int64_t began_ns = batch.observations.front().boottime_ns;
  const uint64_t passed_ns = boottime_ns <= began_ns ? 0
                                                     : static_cast<uint64_t>(boottime_ns) -
                                                           static_cast<uint64_t>(began_ns);
  // One place is the merged graph's.
  if (first.graphs < kGraphsJudgedMax - 1 + passed_ns / kSensorQuietNs) {
    ++first.graphs;
    first.merged.reset();
    return false;
  }
  if (first.merged.has_value() && ports_.counts.graphs_merged) ports_.counts.graphs_merged(1);
  first.merged = event;
  return true;
}

void Robot::JudgeMerged(ControlBatch& batch) {
  if (!batch.merged.has_value()) return;
  engine::Event event = *std::exchange(batch.merged, std::nullopt);
  const auto host = sensors_.find(batch.host);
  if (host == sensors_.end() || !host->second.settled) return;
  GraphChanged(host->second, std::move(event));
  UpdateActuation(ports_.clock->Now());
  if (outbox_.due()) Flush();
}

}  // namespace rips::pipeline
