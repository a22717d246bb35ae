// The last events of one robot, in pieces. Each piece begins with the state that rules judged its
// first event by, so that a replay can begin there. Pure.
//
//   a piece ends      after kPieceNs, when it holds kPieceBytes, when another bundle is in force
//   the oldest goes   when all that is after its end is older than kSpanNs; when the pieces hold
//                     more than kBytesMax together; when another bundle is in force
//
// Bytes are of memory and estimated from above: names are counted with each message although the
// messages of a batch share them, so that a recording that is written out is not longer.
#ifndef RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_RING_H_
#define RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_RING_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/container/node_hash_set.h"
#include "policy_server/server/robot/model/judged_event.h"
#include "services/base/clock.h"
#include "services/model/event.h"
#include "services/ros2/ros_graph.h"

namespace rips::flight {

struct FlightMessage {
  // Of `batch`.
  const pipeline::MessageSeen* seen = nullptr;
  // Of the piece; never null.
  const std::string* sender = nullptr;
  std::shared_ptr<const pipeline::Batch> batch;
  // As JudgedEvent::payload_bytes_max.
  size_t payload_bytes_max = SIZE_MAX;
};

struct FlightEvent {
  int64_t time_unix_ns = 0;
  bool blind = false;
  bool late = false;
  // The graph before this event, if it is not the one that the events so far have led to.
  std::shared_ptr<const ros2::RosGraph> context;
  // Others are behind a pointer, so that a message stays small.
  std::variant<FlightMessage, std::unique_ptr<const ros2::GraphDelta>,
               std::unique_ptr<const model::ExternalEvent>,
               std::unique_ptr<const pipeline::LevelChange>>
      what;
};

struct FlightPiece {
  pipeline::RulesState state;
  // CLOCK_BOOTTIME.
  int64_t began_ns = 0;
  // Of the graph in `state`.
  size_t graph_bytes = 0;
  std::vector<FlightEvent> events;
  // Without graph_bytes.
  size_t bytes = 0;
  absl::node_hash_set<std::string> senders;
  // Counted already.
  absl::flat_hash_set<const pipeline::Batch*> batches;
  // Of the contexts of events, which keep them alive.
  absl::flat_hash_map<const ros2::RosGraph*, size_t> context_bytes;
};

// Oldest first; not empty. What one holds never changes.
using Flight = std::vector<std::shared_ptr<const FlightPiece>>;

// Not thread-safe.
class FlightRing {
 public:
  static constexpr int64_t kSpanNs = 30 * kNanosPerSecond;
  static constexpr int64_t kPieceNs = 5 * kNanosPerSecond;
  static constexpr size_t kPieceBytes = size_t{512} << 10;
  static constexpr size_t kBytesMax = size_t{4} << 20;

  // Before the first event, and from then on whenever wants_piece().
  void Begin(pipeline::RulesState state, Instant now);
  bool wants_piece(Instant now) const;

  void Add(const pipeline::JudgedEvent& judged);
  void Add(const pipeline::LevelChange& level);

  // All that is kept. The piece that grows ends with it, and another one is due.
  Flight Take();
  // Of all pieces, and of the graph that they begin with.
  size_t bytes() const;

 private:
  FlightEvent& AddEvent(int64_t time_unix_ns, size_t bytes);
  void DropOld(Instant now);
  FlightPiece& piece() { return *piece_; }

  // Whole ones, oldest first.
  std::deque<std::shared_ptr<const FlightPiece>> whole_;
  // The one that grows.
  std::shared_ptr<FlightPiece> piece_;
  // It was taken, and must not grow.
  bool taken_ = false;
  // The graph that the events so far have led to.
  std::shared_ptr<const ros2::RosGraph> graph_;
};

// Of a graph that is written out, estimated.
size_t BytesOf(const ros2::RosGraph& graph);
// In memory, estimated.
size_t BytesOf(const model::ExternalEvent& external);
size_t BytesOf(const pipeline::Batch& batch);

}  // namespace rips::flight

#endif  // RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_RING_H_
