#include "policy_server/server/robot/line/control_line.h"

#include <algorithm>
#include <utility>
#include <vector>

namespace rips::pipeline {
namespace {

// A piece ends after a graph, or after so many other observations.
constexpr size_t kPieceMax = 32;
// Graphs of one batch that are judged by an event each, and one more for every 20 ms of the
// sensor's time before: a sensor waits for 20 ms of quiet before it tells of a change
// (graph_builder.h), so an honest one, with a backlog too, never exceeds this. Beyond it, changes
// are applied one by one and judged together.
constexpr size_t kGraphsJudgedMax = 4;
constexpr uint64_t kSensorQuietNs = 20 * kNanosPerMilli;

size_t EndOfPiece(const std::vector<Observation>& observations, size_t from) {
  const size_t end = std::min(observations.size(), from + kPieceMax);
  size_t to = from;
  while (to < end && !IsGraph(observations[to])) ++to;
  return to < end ? to + 1 : end;
}

}  // namespace

Piece ControlLine::Next() {
  WaitingBatch& first = batches_.front().waiting;
  const size_t from = first.judged;
  first.judged = EndOfPiece(first.batch->observations, from);
  return {.waiting = first, .from = from, .to = first.judged, .verdicts = {}};
}

bool ControlLine::Merges(const engine::Event& event, int64_t boottime_ns) {
  if (batches_.empty()) return false;
  Entry& first = batches_.front();
  const int64_t began_ns = first.waiting.batch->observations.front().boottime_ns;
  const uint64_t passed_ns = boottime_ns <= began_ns ? 0
                                                     : static_cast<uint64_t>(boottime_ns) -
                                                           static_cast<uint64_t>(began_ns);
  // One place is the merged graph's.
  if (first.graphs < kGraphsJudgedMax - 1 + passed_ns / kSensorQuietNs) {
    ++first.graphs;
    first.merged.reset();
    return false;
  }
  if (first.merged.has_value()) context_.Count(Counter::kGraphsMerged);
  first.merged = event;
  return true;
}

std::optional<engine::Event> ControlLine::Pop() {
  std::optional<engine::Event> merged = std::move(batches_.front().merged);
  batches_.pop_front();
  return merged;
}

}  // namespace rips::pipeline
