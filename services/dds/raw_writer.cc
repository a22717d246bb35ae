#include "services/dds/raw_writer.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "dds/dds.h"
#include "services/base/status_macros.h"
#include "services/dds/domain_internals.h"
#include "services/dds/qos.h"
#include "services/ros2/ros_name.h"

namespace rips::dds {

absl::StatusOr<std::unique_ptr<RawWriter>> RawWriter::Create(const Participant& participant,
                                                             const RawWriterOptions& options) {
  RIPS_ASSIGN_OR_RETURN(RawTopic topic,
                        CreateRawTopic(participant.entity(), options.topic, options.type));
  const OwnedQos qos = MakeQos(options.user_data);
  dds_qset_reliability(
      qos.get(), options.qos.reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
      kMaxBlocking);
  dds_qset_durability(qos.get(), options.qos.transient_local ? DDS_DURABILITY_TRANSIENT_LOCAL
                                                             : DDS_DURABILITY_VOLATILE);
  const dds_history_kind_t history =
      options.qos.keep_all ? DDS_HISTORY_KEEP_ALL : DDS_HISTORY_KEEP_LAST;
  const auto depth = static_cast<int32_t>(std::max<uint32_t>(options.qos.depth, 1));
  dds_qset_history(qos.get(), history, depth);
  // What readers that come later are given; by itself it would be the last sample only.
  dds_qset_durability_service(qos.get(), 0, history, depth, DDS_LENGTH_UNLIMITED,
                              DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
  SetPartitions(qos.get(), options.qos.partitions);
  if (options.exclusive) dds_qset_ownership(qos.get(), DDS_OWNERSHIP_EXCLUSIVE);
  dds_qset_writer_data_lifecycle(qos.get(), /*autodispose=*/false);
  // What every ROS 2 distribution reads.
  const dds_data_representation_id_t xcdr1 = DDS_DATA_REPRESENTATION_XCDR1;
  dds_qset_data_representation(qos.get(), 1, &xcdr1);

  DdsEntity entity(dds_create_writer(participant.entity(), topic.entity.get(), qos.get(), nullptr));
  if (entity.get() < 0) {
    return DdsError(absl::StrCat("creating a writer of `", ros2::Printable(options.topic), "`"),
                    entity.get());
  }
  RIPS_ASSIGN_OR_RETURN(const ros2::Guid guid, GuidOf(entity.get()));
  dds_instance_handle_t instance = 0;
  if (const dds_return_t code = dds_get_instance_handle(entity.get(), &instance); code < 0) {
    return DdsError("reading a writer's instance handle", code);
  }
  return std::unique_ptr<RawWriter>(
      new RawWriter(std::move(topic), std::move(entity), guid, instance,
                    participant.own_endpoints()->Add(options.topic, guid, /*writer=*/true)));
}

absl::Status RawWriter::Write(absl::string_view payload, int64_t source_unix_ns) {
  return WriteRaw(entity_.get(), topic_.type, payload, source_unix_ns);
}

void RawWriter::LimitLinger(absl::Duration longest) const {
  rips_dds_limit_linger(topic_.type, absl::ToInt64Nanoseconds(longest));
}

size_t RawWriter::MatchedReaders() const {
  const dds_return_t count = dds_get_matched_subscriptions(entity_.get(), nullptr, 0);
  return count < 0 ? 0 : static_cast<size_t>(count);
}

}  // namespace rips::dds
