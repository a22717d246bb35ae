// Writer of a topic whose type is known by name only; the caller encodes.
#ifndef RIPS_SERVICES_DDS_RAW_WRITER_H_
#define RIPS_SERVICES_DDS_RAW_WRITER_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/dds/dds_entity.h"
#include "services/dds/participant.h"
#include "services/dds/raw_type.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::dds {

struct RawWriterOptions {
  // DDS names, "rt/chatter" and "std_msgs::msg::dds_::String_".
  std::string topic;
  std::string type;
  // depth 0 = 1; partitions empty = the default partition.
  ros2::Qos qos = {.reliable = true, .depth = 10, .partitions = {}};
  std::string user_data;
  // Exclusive ownership: readers that ask for a shared one, as all of ROS do, do not match.
  bool exclusive = false;
};

// Any thread. Must not outlive its participant.
class RawWriter {
 public:
  static absl::StatusOr<std::unique_ptr<RawWriter>> Create(const Participant& participant,
                                                           const RawWriterOptions& options);

  // `payload` is a CDR payload with encapsulation header (XCDR1). Blocks for up to 100 ms when a
  // reliable keep-all reader lags, then DeadlineExceeded. InvalidArgument below 4 bytes.
  // `source_unix_ns` 0 = now.
  absl::Status Write(absl::string_view payload, int64_t source_unix_ns = 0);

  const ros2::Guid& guid() const { return guid_; }
  InstanceHandle instance() const { return instance_; }
  EntityHandle entity() const { return entity_.get(); }
  size_t MatchedReaders() const;
  // Of every writer of the domain: how long its end waits, at most, for readers that have not
  // acknowledged its samples (Cyclone's setting is 1 s).
  void LimitLinger(absl::Duration longest) const;

 private:
  RawWriter(RawTopic topic, DdsEntity entity, const ros2::Guid& guid, InstanceHandle instance,
            OwnEndpoints::Entry listed)
      : topic_(std::move(topic)),
        listed_(std::move(listed)),
        entity_(std::move(entity)),
        guid_(guid),
        instance_(instance) {}

  RawTopic topic_;
  OwnEndpoints::Entry listed_;
  DdsEntity entity_;  // after topic_: goes first
  ros2::Guid guid_;
  InstanceHandle instance_;
};

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_RAW_WRITER_H_
