// Reads every topic that somebody writes: one reader for each (topic, type, latched or not) while
// there is a writer for it. Of each sample only what describes it is kept, and of the payload what
// the interest in the topic asks for; without one the payload is not even copied.
//
// A reader never asks for more than its writers offer, so nothing on the robot is slowed: volatile
// and best-effort, or transient-local and reliable for writers that offer both. Request topics of
// services are never read: rmw_fastrtps clients take a service for incomplete when its request
// topic has more readers than its reply topic has writers.
#ifndef RIPS_SENSOR_AGENT_DDS_TOPIC_WATCHER_H_
#define RIPS_SENSOR_AGENT_DDS_TOPIC_WATCHER_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <tuple>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/status/status.h"
#include "sensor_agent/graph_builder.h"
#include "sensor_agent/interest.h"
#include "sensor_agent/message_flow.h"
#include "sensor_agent/payload_pool.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_type.h"
#include "services/runtime/bounded_queue.h"

namespace rips::sensor {

struct TopicWatcherOptions {
  size_t readers = 4'096;
  // Samples received and not yet taken; beyond, the new one is lost and counted.
  size_t queue = 65'536;
  // Of payloads, from reception until they are acknowledged; beyond, the sample is kept without.
  size_t payload_bytes = size_t{80} << 20;
};

// One thread, except that samples arrive on the middleware's receive threads.
class TopicWatcher {
 public:
  // `wake` is called on receive threads after a sample was queued. `participant` is not owned and
  // outlives this.
  TopicWatcher(const dds::Participant* participant, TopicWatcherOptions options,
               std::function<void()> wake);

  // Sees to it that `writer`, a writer of a ROS topic, is read. Again for one already read: OK.
  // ResourceExhausted past the limit on readers; the middleware's error otherwise. InvalidArgument
  // if it is not a writer on `rt/`.
  absl::Status Watch(const EndpointFact& writer);
  void WriterGone(const ros2::Guid& writer);
  // For what is received from now on, of topics read now and later.
  void SetInterest(std::shared_ptr<const Interest> interest);

  // Received since the last call, in order of reception; at most `max`.
  std::vector<Sample> Take(size_t max);
  // Samples lost because the queue was full, since the last call: one record for each topic.
  std::vector<Loss> TakeLosses(int64_t now_ns);

  // Payloads not kept because too many were held, since the last call.
  uint64_t TakePayloadsRefused() { return payloads_.TakeRefused(); }

  size_t readers() const { return readers_.size(); }

 private:
  using Key = std::tuple<std::string, std::string, bool>;  // DDS topic, DDS type, latched

  struct Reader {
    std::shared_ptr<const ReaderKey> key;
    std::atomic<uint64_t> overflow = 0;
    // Bytes of each payload that are wanted; 0 = none.
    const std::shared_ptr<dds::PayloadLimit> wanted = std::make_shared<dds::PayloadLimit>(0);
    absl::flat_hash_set<ros2::Guid> writers;
    std::unique_ptr<dds::RawReader> reader;  // last: goes first, then no callback runs
  };

  absl::Status Open(const Key& key);
  void OnSample(Reader& reader, const dds::RawSample& sample);
  uint32_t Wanted(const ReaderKey& key) const;
  void CountOverflow(Reader& reader);

  const dds::Participant* participant_;
  const TopicWatcherOptions options_;
  const std::function<void()> wake_;
  PayloadPool payloads_;
  BoundedQueue<Sample> queue_;
  // Null = metadata of everything.
  std::shared_ptr<const Interest> interest_;
  absl::flat_hash_map<ros2::Guid, Key> key_of_;
  // Losses not yet taken, by ROS topic.
  absl::btree_map<std::string, uint64_t> lost_;
  // After queue_: readers go first.
  absl::btree_map<Key, std::unique_ptr<Reader>> readers_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_DDS_TOPIC_WATCHER_H_
