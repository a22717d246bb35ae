// The control lane of a robot's sensors: batches in the order they came, of which the first is
// judged, piece after piece. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_CONTROL_LINE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_CONTROL_LINE_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>

#include "policy_server/policy/engine/state/event.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/line/waiting_batches.h"

namespace rips::pipeline {

// Not thread-safe.
class ControlLine {
 public:
  // `context` outlives this.
  explicit ControlLine(Context* context) : context_(*context) {}

  void Push(WaitingBatch batch) { batches_.push_back({.waiting = std::move(batch)}); }
  void Clear() { batches_.clear(); }
  bool empty() const { return batches_.empty(); }

  // Both: not empty. The batch that is being judged, and its next piece: up to a graph, or some
  // other observations. It counts as judged.
  const WaitingBatch& first() const { return batches_.front().waiting; }
  Piece Next();
  // The first batch shows another graph, by `event`. True: it is not judged by itself, since the
  // sensor tells of more graphs in one batch than a sensor does; the next one stands for it, or
  // Pop.
  bool Merges(const engine::Event& event, int64_t boottime_ns);
  // Removes the first batch: the event of its newest graph that was merged, if any.
  std::optional<engine::Event> Pop();

 private:
  struct Entry {
    WaitingBatch waiting;
    // Graphs that were judged, each by an event of its own.
    size_t graphs = 0;
    // Of the newest graph, which is held and not judged yet.
    std::optional<engine::Event> merged;
  };

  Context& context_;
  std::deque<Entry> batches_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_LINE_CONTROL_LINE_H_
