// From received samples to observations: every message attributed to its writer's node, each once,
// and gaps in a writer's sequence reported.
//
// A writer's sequence is remembered until the writer has gone, also while its topic is not read.
// So when a topic is read anew and a latched writer sends its history again, what was judged before
// is a duplicate; what is newer is judged now, and what lies between and was not kept is no loss.
// The writer chooses its numbers: one that is lower than others and has not come is judged, too.
//
// A sample whose writer is still without a node waits until the graph attributes it or the grace is
// over; then it runs as it is. Samples of one writer keep their order.
//
// Every message names a version of the graph, so that the server judges it against that one,
// whichever of the two arrives first:
//
// | the writer                           | the version named                          |
// |--------------------------------------|--------------------------------------------|
// | stands in the newest version sent    | that one                                   |
// | is known, and not in a step sent yet | the next one, which will show it           |
// | has gone                             | the one that its last message named        |
// | was never discovered                 | the newest one (the first, if none is sent) |
#ifndef RIPS_SENSOR_AGENT_MESSAGES_MESSAGE_FLOW_H_
#define RIPS_SENSOR_AGENT_MESSAGES_MESSAGE_FLOW_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_set.h"
#include "absl/container/flat_hash_map.h"
#include "sensor_agent/graph/graph_builder.h"
#include "sensor_agent/messages/seen_numbers.h"
#include "sensor_agent/messages/sequence_jump.h"
#include "sensor_agent/outbox/observation.h"
#include "services/ros2/guid.h"

namespace rips::sensor {

// What one reader reads.
struct ReaderKey {
  std::string topic;  // ROS names
  std::string type;
  // Reliable and transient-local; such writers are matched by the other reader of the topic, too,
  // if there is one.
  bool latched = false;
  // Opened after a time in which the topic was not needed: what its writers wrote meanwhile is no
  // loss.
  bool resumed = false;
};

struct Sample {
  ros2::Guid writer;  // none() = not known
  std::shared_ptr<const ReaderKey> reader;
  uint32_t size_bytes = 0;
  Payload payload;
  uint64_t sequence = 0;  // RTPS; 0 = not known
  int64_t source_unix_ns = 0;
  int64_t received_ns = 0;  // CLOCK_BOOTTIME
};

struct FlowOptions {
  int64_t attribution_grace_ns = 500'000'000;
  // Samples that may wait, of one writer and in all; beyond, the writer's oldest run at once.
  size_t waiting_per_writer = 256;
  size_t waiting = 8'192;
  // Writers remembered. Samples of more run without duplicate and gap detection.
  size_t writers = 32'768;
  // How long a writer is remembered after it went: samples in queues outlive it.
  int64_t tombstone_ns = 10'000'000'000;
};

struct FlowCounters {
  uint64_t duplicates = 0;
  // Ran without a node: past the grace, or pushed out of the waiting room.
  uint64_t unattributed = 0;
};

// Not thread-safe; no clock: times are CLOCK_BOOTTIME in nanoseconds.
class MessageFlow {
 public:
  struct Output {
    std::vector<MessageSeen> messages;
    std::vector<Loss> losses;
    // At most one for each sample.
    std::vector<SequenceJump> jumps;
  };

  // `graph` is not owned and outlives this.
  MessageFlow(FlowOptions options, const GraphBuilder* graph) : options_(options), graph_(graph) {}

  void Take(Sample sample, int64_t now_ns, Output& output);
  // `count` samples of `writer` on `topic` were received and could not be queued. They are a loss
  // of their own and no gap as well: tell of them before the samples that were queued after them.
  void QueueLost(const ros2::Guid& writer, const std::string& topic, uint64_t count, int64_t now_ns,
                 Output& output);
  // Call after the graph has changed: what was waiting for it runs.
  void Poll(int64_t now_ns, Output& output);
  // Call before it has gone from the graph, which says whose its samples in queues are.
  void WriterGone(const ros2::Guid& guid, int64_t now_ns);
  // kNever = not before another sample.
  int64_t NextDue() const;
  // Of what was received of this writer; 0 = nothing, or nothing that is remembered.
  uint64_t HighestSequence(const ros2::Guid& writer) const;

  const FlowCounters& counters() const { return counters_; }

 private:
  struct Writer {
    // As last introduced; null = not yet.
    std::shared_ptr<const MessageSource> source;
    // Of the graph, when `source` was taken from it and not pending; 0 = must look again.
    uint64_t revision = 0;
    // Named by the newest message; 0 = none yet.
    uint64_t graph_version = 0;
    // Of the graph, when the newest version sent showed the writer; 0 = must look again.
    uint64_t shown_revision = 0;
    // That have run or were duplicates, since it was discovered.
    SeenNumbers seen;
    // Of the newest sample that was not a duplicate: its number, 0 = none yet, and when it came.
    uint64_t newest = 0;
    int64_t newest_ns = 0;
    // Missing samples that are counted already.
    uint64_t queue_lost = 0;
    // Of the newest sample that was not a duplicate.
    std::shared_ptr<const ReaderKey> reader;
    std::deque<std::pair<int64_t, Sample>> waiting;  // with the end of its wait
    int64_t gone_ns = 0;                             // 0 = alive
  };

  bool MustWait(const Sample& sample, const Writer& writer) const;
  // What is impossible in the number of `sample`, which has not come before; empty = nothing.
  static std::string WhyImpossible(const Sample& sample, const Writer& writer);
  void Run(const Sample& sample, Writer& writer, Output& output);
  void RunFront(Writer& writer, Output& output);
  void Introduce(const Sample& sample, Writer& writer, bool& urgent);
  // The version of the graph that a message of this writer names.
  uint64_t GraphVersion(const ros2::Guid& guid, Writer& writer) const;
  // Forgets the writer after tombstone_ns, unless the graph has it then.
  void End(const ros2::Guid& guid, Writer& writer, int64_t now_ns);
  void Bury(int64_t now_ns);

  const FlowOptions options_;
  const GraphBuilder* graph_;
  FlowCounters counters_;
  absl::flat_hash_map<ros2::Guid, std::unique_ptr<Writer>> writers_;
  absl::btree_set<ros2::Guid> waiting_writers_;
  size_t waiting_ = 0;
  std::deque<std::pair<int64_t, ros2::Guid>> graves_;  // by time of going
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_MESSAGES_MESSAGE_FLOW_H_
