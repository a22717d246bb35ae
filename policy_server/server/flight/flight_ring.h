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

#include <array>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <type_traits>
#include <variant>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/container/node_hash_set.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/robot/model/judged_event.h"
#include "services/base/clock.h"
#include "services/model/event.h"
#include "services/ros2/ros_graph.h"

namespace rips::flight {

// Small, since most are messages, and trivial, since a piece drops thousands of them at once.
struct FlightEvent {
  int64_t time_unix_ns = 0;
  // Of a message: as a batch of the piece holds it, and the name that the piece holds. `sender` is
  // null of what is no message.
  const pipeline::MessageSeen* seen = nullptr;
  const std::string* sender = nullptr;
  // As JudgedEvent::payload_bytes_max; the largest is all of it.
  uint32_t payload_bytes_max = UINT32_MAX;
  engine::StandingFindings findings;
  bool blind = false;
  bool late = false;
};
static_assert(std::is_trivially_destructible_v<FlightEvent> && sizeof(FlightEvent) <= 32);

// What an event is that is no message.
struct FlightOther {
  // Index of FlightPiece::events.
  size_t event = 0;
  // A difference may be a part of the batch that brought it, which it keeps alive.
  std::variant<std::shared_ptr<const ros2::GraphDelta>, model::ExternalEvent, pipeline::LevelChange>
      what;
};

// The graph before an event, where it is not the one that the events so far have led to.
struct FlightContext {
  // Index of FlightPiece::events.
  size_t event = 0;
  std::shared_ptr<const ros2::RosGraph> graph;
};

struct FlightPiece {
  pipeline::RulesState state;
  // CLOCK_BOOTTIME.
  int64_t began_ns = 0;
  // Of the graph in `state`.
  size_t graph_bytes = 0;
  std::vector<FlightEvent> events;
  // Both by event.
  std::vector<FlightOther> others;
  std::vector<FlightContext> contexts;
  // Without graph_bytes.
  size_t bytes = 0;
  absl::node_hash_set<std::string> senders;
  // Each counted once. They keep messages alive.
  absl::flat_hash_set<std::shared_ptr<const pipeline::Batch>> batches;
  // Of `contexts`, which keep them alive.
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
  // A larger change of the graph is compared with the graph before: much of it may be no news.
  static constexpr size_t kToldBytesMax = kPieceBytes / 8;

  // Before the first event, and from then on whenever wants_piece().
  void Begin(pipeline::RulesState state, Instant now);
  bool wants_piece(Instant now) const;

  // As action::RecordEvent; a piece does not begin between the events of one input.
  void Add(const pipeline::JudgedEvent& judged);
  void Add(const pipeline::LevelChange& level);

  // All that is kept. The piece that grows ends with it, and another one is due.
  Flight Take();
  // Of all pieces, and of the graph that they begin with.
  size_t bytes() const;

 private:
  FlightEvent& AddEvent(int64_t time_unix_ns);
  // Of the last event.
  void AddOther(decltype(FlightOther::what) what, size_t bytes);
  void CountBatch(const std::shared_ptr<const pipeline::Batch>& batch);
  // That name, as the piece keeps it.
  const std::string* SenderOf(absl::string_view name);
  // From `graph_` to the graph of a GraphEvent.
  std::shared_ptr<const ros2::GraphDelta> DifferenceOf(const pipeline::JudgedEvent& judged);
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
  // The newest graph of the robot; `graph_` unless the last message was taken under an earlier one.
  std::shared_ptr<const ros2::RosGraph> newest_;
  // Of the piece, by a hash of where their name was.
  std::array<const std::string*, 64> recent_senders_ = {};
};

// Of a graph that is written out, estimated.
size_t BytesOf(const ros2::RosGraph& graph);
// In memory, estimated.
size_t BytesOf(const model::ExternalEvent& external);
size_t BytesOf(const pipeline::Batch& batch);

}  // namespace rips::flight

#endif  // RIPS_POLICY_SERVER_SERVER_FLIGHT_FLIGHT_RING_H_
