// Reader of a topic whose type is known by name only.
#ifndef RIPS_SERVICES_DDS_RAW_READER_H_
#define RIPS_SERVICES_DDS_RAW_READER_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/base/clock.h"
#include "services/dds/participant.h"
#include "services/dds/raw_type.h"
#include "services/ros2/guid.h"

namespace rips::dds {

struct RawReaderOptions {
  // DDS names, "rt/chatter" and "std_msgs::msg::dds_::String_".
  std::string topic;
  std::string type;
  // Reliable and transient-local, for writers that offer both. Otherwise best-effort and
  // volatile: that matches every writer and can never slow one down.
  bool reliable_transient_local = false;
  // Reliable and volatile; only for what must not be lost and is ours (service requests and
  // replies).
  bool reliable = false;
  // History is keep-last; one cache is shared by all writers of the topic.
  uint32_t depth = 1'000;
  // Keep all samples until taken: only for ros_discovery_info.
  bool keep_all = false;
  // Bytes of each payload that are kept; RawSample::size is the true size.
  uint32_t payload_bytes_max = kWholePayload;
  // In place of payload_bytes_max, for a reader that keeps more or less as it goes.
  std::shared_ptr<const PayloadLimit> payload_limit;
  // Receive from writers in any partition. Not done under DDS Security, which refuses a partition
  // list that its permissions do not name.
  bool every_partition = true;
  // Do not match writers of our own participant.
  bool ignore_own = true;
  // Announced with the endpoint; the services use it.
  std::string user_data;
  // Further partitions to receive from: names that a writer's patterns match, which
  // `every_partition` does not (DDS 1.4 §2.2.3.13: a pattern never matches a pattern).
  std::vector<std::string> partitions;
  // A writer was matched or is no longer. On Cyclone's threads, perhaps before Create returns; set
  // a flag and return.
  std::function<void()> on_match;
};

// Valid during the callback only.
struct RawSample {
  absl::string_view payload;  // encapsulation header and body, cut to the limit
  uint32_t size = 0;          // bytes of the whole payload
  // RTPS sequence number: counts from 1 per writer, a jump is a loss. 0 = not known (the writer
  // is in this process).
  uint64_t writer_sequence = 0;
  // The writer's clock, nanoseconds since the Unix epoch; whatever the writer says.
  int64_t source_unix_ns = 0;
  Instant received;
  // Instance handle of the writer: equal to EndpointSeen::instance.
  InstanceHandle publication = 0;
  // The writer; none() if it was gone before its first sample was taken and was never seen here.
  ros2::Guid writer;
  // The sample that this one answers, if its writer says so beside the payload (Fast DDS).
  ros2::Guid related_writer;
  uint64_t related_sequence = 0;
};

// What the middleware holds of a writer's sequence numbers, for all its readers in this process.
struct WriterNumbers {
  uint64_t next = 0;       // the lowest that it does not drop as old
  uint64_t last = 0;       // the highest that the writer is known to have written
  uint64_t discarded = 0;  // bytes of samples that it dropped
};

// Runs on Cyclone's receive threads (unicast and multicast), or on the writing thread for writers
// of this process; calls for one reader never overlap. Copy, enqueue, return: no lock that others
// hold for long, no I/O, no call that creates or deletes DDS entities.
using RawCallback = std::function<void(const RawSample&)>;

// Any thread. Must not outlive its participant.
class RawReader {
 public:
  static absl::StatusOr<std::unique_ptr<RawReader>> Create(const Participant& participant,
                                                           const RawReaderOptions& options,
                                                           RawCallback callback);
  // Returns when no callback runs any more. Not from within a callback.
  ~RawReader();

  RawReader(const RawReader&) = delete;
  RawReader& operator=(const RawReader&) = delete;

  const ros2::Guid& guid() const;
  EntityHandle entity() const;
  // Writers that send to this reader now; one that discovery shows and that is missing here is
  // not visible to us.
  std::vector<ros2::Guid> MatchedWriters() const;

  // Of any writer that discovery shows in this reader's domain, also of discovery itself
  // (SEDP, entity ids 0x3c2 and 0x4c2); nullopt if there is no such writer.
  std::optional<WriterNumbers> NumbersOf(const ros2::Guid& writer) const;
  // As if nothing had been received of that writer, by any reader of this process: lower numbers
  // are delivered, and a reliable writer is asked for all that it keeps, which comes again. False
  // if there is no such writer.
  bool ForgetNumbersOf(const ros2::Guid& writer) const;

 private:
  struct Impl;
  explicit RawReader(std::unique_ptr<Impl> impl);

  std::unique_ptr<Impl> impl_;
};

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_RAW_READER_H_
