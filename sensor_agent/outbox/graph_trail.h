// The graph since the time of the oldest message that is held. What is set aside brings the graph
// of its time from here: the server that judges it may hold none, and who was there then is not who
// is there now.
//
// | a batch of messages                                  | brings                               |
// |------------------------------------------------------|--------------------------------------|
// | is the first of an outage, or the kBatchesMax-th     | a snapshot                           |
// | since the last snapshot                              |                                      |
// | is of a later version than the batch before it       | the steps between                    |
// | else, or if the graph is not known or too large      | nothing                              |
#ifndef RIPS_SENSOR_AGENT_OUTBOX_GRAPH_TRAIL_H_
#define RIPS_SENSOR_AGENT_OUTBOX_GRAPH_TRAIL_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <vector>

#include "sensor_agent/outbox/graph_base.h"
#include "sensor_agent/outbox/observation.h"

namespace rips::sensor {

// Not thread-safe.
class GraphTrail {
 public:
  // Of the steps held; beyond either, messages older than the oldest of them bring the graph after
  // it. By the estimate of CostOf.
  static constexpr size_t kStepsMax = 1'024;
  static constexpr size_t kStepBytesMax = size_t{1} << 20;
  // What one batch brings at most, by that estimate: with its messages it must fit into the half of
  // a stream's credit that the backlog may use.
  static constexpr size_t kBroughtBytesMax = size_t{320} << 10;
  // So many batches rely on one snapshot: a connection may begin behind it.
  static constexpr int kBatchesMax = 32;

  // What the batches of one stream have brought.
  struct Brought {
    // Of the graph; 0 = none.
    uint64_t version = 0;
    // Since the last snapshot.
    int batches = 0;
  };

  void Add(const GraphChange& change);
  // No message of a version before `version` is held any more.
  void Advance(uint64_t version);
  void Clear();

  // For a batch of messages of `version`, which is put into its stream after what was `brought`.
  std::vector<GraphChange> Bring(uint64_t version, Brought& brought);
  // The version that was brought last; if none was, that of no graph.
  uint64_t brought() const { return brought_; }

 private:
  std::vector<GraphChange> StepsBetween(uint64_t from, uint64_t to) const;

  GraphBase base_;
  // Later than the base.
  std::deque<GraphChange> steps_;
  size_t step_bytes_ = 0;
  uint64_t brought_ = std::numeric_limits<uint64_t>::max();
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_GRAPH_TRAIL_H_
