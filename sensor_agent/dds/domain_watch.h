// One DDS domain as this sensor watches it: who is there, what they claim about their nodes, and
// what is written. Facts wait in bounded queues until they are taken.
#ifndef RIPS_SENSOR_AGENT_DDS_DOMAIN_WATCH_H_
#define RIPS_SENSOR_AGENT_DDS_DOMAIN_WATCH_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "sensor_agent/dds/topic_watcher.h"
#include "sensor_agent/graph/graph_builder.h"
#include "sensor_agent/messages/sequence_watch.h"
#include "services/dds/discovery.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/runtime/bounded_queue.h"

namespace rips::sensor {

struct DomainWatchOptions {
  dds::DomainOptions domain;
  dds::ParticipantOptions participant;
  // Facts of discovery not yet taken. Beyond, discovery must be told anew (Rediscover).
  size_t discovered = 65'536;
  // Messages of ros_discovery_info not yet taken, and their bytes together.
  size_t claims = 4'096;
  size_t claim_bytes = size_t{16} << 20;
  TopicWatcherOptions topics;
};

// Not alive: only the GUID means anything.
struct Discovered {
  bool alive = false;
  std::variant<ros2::Participant, EndpointFact> what;
  // Of a participant: the locators it is reached at, as the middleware prints them.
  std::string addresses;
};

// A message of ros_discovery_info.
struct Claim {
  ros2::Guid writer;
  std::string payload;
};

// One thread, except that facts arrive on the middleware's threads.
class DomainWatch {
 public:
  // `wake` is called from the middleware's threads when there is something to take; it must not
  // block. The middleware's errors.
  static absl::StatusOr<std::unique_ptr<DomainWatch>> Create(DomainWatchOptions options,
                                                             std::function<void()> wake);

  const ros2::Guid& own() const { return participant_->guid(); }
  const dds::Participant& participant() const { return *participant_; }

  std::vector<Discovered> TakeDiscovered();
  std::vector<Claim> TakeClaims();
  // Facts and claims lost because their queue was full, since the last call.
  uint64_t TakeLostDiscovered() { return lost_discovered_.exchange(0); }
  uint64_t TakeLostClaims() { return lost_claims_.exchange(0); }
  // Has everything that is there now told again.
  absl::Status Rediscover();

  // What the middleware holds of the sequence numbers of any writer, for SequenceWatch.
  std::optional<HeldNumbers> NumbersOf(const ros2::Guid& writer) const;
  void ForgetNumbersOf(const ros2::Guid& writer) const { claim_reader_->ForgetNumbersOf(writer); }

  TopicWatcher& topics() { return *topics_; }

 private:
  DomainWatch(DomainWatchOptions options, std::function<void()> wake);

  void OnDiscovered(Discovered discovered);
  void OnClaim(const dds::RawSample& sample);

  const DomainWatchOptions options_;
  const std::function<void()> wake_;
  BoundedQueue<Discovered> discovered_;
  BoundedQueue<Claim> claims_;
  std::atomic<size_t> claim_bytes_ = 0;
  std::atomic<uint64_t> lost_discovered_ = 0;
  std::atomic<uint64_t> lost_claims_ = 0;
  // In this order, so that what calls back goes before what it uses.
  std::unique_ptr<dds::Participant> participant_;
  std::unique_ptr<TopicWatcher> topics_;
  std::unique_ptr<dds::RawReader> claim_reader_;
  std::unique_ptr<dds::Discovery> discovery_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_DDS_DOMAIN_WATCH_H_
