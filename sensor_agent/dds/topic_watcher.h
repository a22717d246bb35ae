// Reads every topic that the plan wants: one reader for each (topic, type, latched or not) while
// there is a writer for it. Of each sample only what describes it is kept, and of the payload what
// the plan asks for; without that the payload is not even copied.
//
// A topic with a subscriber and no writer is read, too: a writer that comes then meets our reader
// when it meets the subscriber, before we are told of it, so it is seen although it may be gone a
// moment later.
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

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "absl/container/btree_set.h"
#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/status/status.h"
#include "sensor_agent/graph/graph_builder.h"
#include "sensor_agent/interest/interest.h"
#include "sensor_agent/messages/message_flow.h"
#include "sensor_agent/messages/payload_pool.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_type.h"
#include "services/runtime/bounded_queue.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

struct TopicWatcherOptions {
  size_t readers = 4'096;
  // Writers and subscribers known at a time.
  size_t endpoints = 32'768;
  // Samples received and not yet taken; beyond, the new one is lost and counted.
  size_t queue = 65'536;
  // Of payloads, from reception until they are acknowledged; beyond, the sample is kept without.
  size_t payload_bytes = size_t{80} << 20;
  // How long a writer may take to match its reader before it counts as not visible.
  int64_t match_ns = 2'000'000'000;
  // DDS Security is on: a list of partitions would be refused, and a permission may be missing.
  bool secured = false;
};

// Writers of one topic whose overflow is counted apart.
inline constexpr size_t kOverflowWritersMax = 1'024;

// News about a writer whose topic is wanted. Until there is news it is taken for visible.
struct Coverage {
  ros2::Guid writer;
  // Why its messages do not come; empty = they do.
  std::string not_visible;
};

// Samples of one writer that were received and not queued.
struct QueueLoss {
  std::string topic;  // ROS name
  ros2::Guid writer;  // none() = several or not known
  uint64_t count = 0;
};

// One thread, except that samples arrive on the middleware's receive threads. Times are
// CLOCK_BOOTTIME in nanoseconds.
class TopicWatcher {
 public:
  // `wake` is called on receive threads after a sample was queued. `participant` is not owned and
  // outlives this. Metadata of every topic is read until SetPlan.
  TopicWatcher(const dds::Participant* participant, TopicWatcherOptions options,
               std::function<void()> wake);

  // `endpoint`, of a ROS topic, is there: if the plan wants its topic it is read from now on, and
  // whenever a later plan wants it. Again for a known one: OK. ResourceExhausted past a limit; the
  // middleware's error if a reader cannot be made; both are news (TakeCoverage), too.
  // InvalidArgument if its topic is not on `rt/`.
  absl::Status Watch(const EndpointFact& endpoint, int64_t now_ns);
  void EndpointGone(const ros2::Guid& endpoint);
  // Its sequence numbers jumped: what comes is handed on, but it is not visible until it has gone.
  void SetJumped(const ros2::Guid& writer);
  // Opens and closes readers. Payloads: for what is received from now on.
  void SetPlan(std::shared_ptr<const WatchPlan> plan, int64_t now_ns);

  // Received since the last call, in order of reception; at most `max`.
  std::vector<Sample> Take(size_t max);
  // Samples lost because the queue was full, since the last call: one record for each topic and
  // writer. Called after Take, it tells of all that were lost before the samples taken.
  std::vector<QueueLoss> TakeLosses();
  // What has turned out about writers since the last call.
  std::vector<Coverage> TakeCoverage(int64_t now_ns);
  // When TakeCoverage may have something to say without anything happening; kNever = not before.
  int64_t NextDue() const;

  // Payloads not kept because too many were held, since the last call.
  uint64_t TakePayloadsRefused() { return payloads_.TakeRefused(); }

  size_t readers() const { return readers_; }
  // There is a reader for this writer, and nothing is known against it.
  bool Reads(const ros2::Guid& writer) const;

 private:
  // DDS topic, DDS type, latched, and a partition to receive from besides all that have a name
  // (empty = none).
  using Key = std::tuple<std::string, std::string, bool, std::string>;

  struct Reader {
    std::shared_ptr<const ReaderKey> key;
    // Past kOverflowWritersMax the rest is of none() in particular.
    Mutex mu;
    absl::flat_hash_map<ros2::Guid, uint64_t> overflow ABSL_GUARDED_BY(mu);
    std::atomic<bool> matches_changed = false;
    // Bytes of each payload that are wanted; 0 = none.
    const std::shared_ptr<dds::PayloadLimit> wanted = std::make_shared<dds::PayloadLimit>(0);
    std::unique_ptr<dds::RawReader> reader;  // last: goes first, then no callback runs
  };
  struct Member {
    Key key;
    bool writer = false;
    std::string unreadable;
    // It must be matched by then; 0 = it is, or was told to be not visible.
    int64_t match_by_ns = 0;
    bool visible = true;  // as told
    bool jumped = false;
  };
  // Endpoints that one reader is for.
  struct Group {
    std::string topic;  // ROS names
    std::string type;
    Wanted wanted;
    absl::flat_hash_set<ros2::Guid> members;
    // Null = not wanted, or refused because of `problem`.
    std::unique_ptr<Reader> reader;
    absl::Status problem;
    // When matches are looked at next; 0 = not before they change.
    int64_t look_ns = 0;
  };

  static Key KeyOf(const EndpointFact& endpoint);
  Group& Join(const Key& key);
  void Open(const Key& key, Group& group, bool resumed, int64_t now_ns);
  absl::Status Create(const Key& key, Group& group, bool resumed);
  void Close(Group& group);
  // Of groups that were refused while there were too many readers.
  void Retry(int64_t now_ns);
  void Expect(const Key& key, Group& group, Member& member, int64_t now_ns);
  void LookAt(const Key& key, Group& group, int64_t now_ns);
  void LookAgain(const Key& key, Group& group, int64_t at_ns);
  void Tell(const ros2::Guid& writer, Member& member, std::string not_visible);
  std::string WhyNotMatched(const Member& member) const;
  void OnSample(Reader& reader, const dds::RawSample& sample);
  void CountOverflow(Reader& reader);

  const dds::Participant* participant_;
  const TopicWatcherOptions options_;
  const std::function<void()> wake_;
  PayloadPool payloads_;
  BoundedQueue<Sample> queue_;
  std::shared_ptr<const WatchPlan> plan_;
  absl::flat_hash_map<ros2::Guid, Member> members_;
  // Losses not yet taken, of readers that are closed.
  std::vector<QueueLoss> lost_;
  std::vector<Coverage> coverage_;
  absl::btree_set<std::pair<int64_t, Key>> looks_;
  size_t readers_ = 0;
  bool room_for_readers_ = false;
  // Some reader has overflow, or changed matches.
  std::atomic<bool> overflowed_ = false;
  std::atomic<bool> matches_changed_ = false;
  // After queue_: readers go first.
  absl::btree_map<Key, Group> groups_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_DDS_TOPIC_WATCHER_H_
