// Cyclone's QoS objects, owned and read, and its GUIDs. Internal to services/dds.
#ifndef RIPS_SERVICES_DDS_QOS_H_
#define RIPS_SERVICES_DDS_QOS_H_

#include <memory>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "dds/dds.h"
#include "services/ros2/ros_graph.h"

namespace rips::dds {

struct QosDeleter {
  void operator()(dds_qos_t* qos) const { dds_delete_qos(qos); }
};
using OwnedQos = std::unique_ptr<dds_qos_t, QosDeleter>;

// Longest that a reliable write waits for a slow reader.
inline constexpr dds_duration_t kMaxBlocking = DDS_MSECS(100);

ros2::Guid ToGuid(const dds_guid_t& guid);

// With `user_data` unless it is empty.
OwnedQos MakeQos(absl::string_view user_data);

void SetPartitions(dds_qos_t* qos, const std::vector<std::string>& partitions);

// Of a discovered endpoint. Partitions are made printable, at most kPartitionsMax of them.
inline constexpr uint32_t kPartitionsMax = 64;
ros2::Qos ReadQos(const dds_qos_t* qos);

// Why no RawReader can match a writer that offers this, "QoS: exclusive ownership"; empty = one can.
std::string WhyUnreadable(const dds_qos_t* qos);

// User data, cut to kUserDataBytesMax.
inline constexpr size_t kUserDataBytesMax = 1'024;
std::string ReadUserData(const dds_qos_t* qos);

// Property `name`, made printable; empty if there is none.
std::string ReadProperty(const dds_qos_t* qos, const char* name);

// The value of "key=value;" in `user_data`; empty if there is none.
std::string UserDataField(absl::string_view user_data, absl::string_view key);

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_QOS_H_
