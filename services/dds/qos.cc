#include "services/dds/qos.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "services/ros2/ros_name.h"

namespace rips::dds {

ros2::Guid ToGuid(const dds_guid_t& guid) {
  ros2::Guid copy;
  std::copy(std::begin(guid.v), std::end(guid.v), copy.bytes.begin());
  return copy;
}

OwnedQos MakeQos(absl::string_view user_data) {
  OwnedQos qos(dds_create_qos());
  if (!user_data.empty()) dds_qset_userdata(qos.get(), user_data.data(), user_data.size());
  return qos;
}

void SetPartitions(dds_qos_t* qos, const std::vector<std::string>& partitions) {
  if (partitions.empty()) return;
  std::vector<const char*> names;
  for (const std::string& partition : partitions) names.push_back(partition.c_str());
  dds_qset_partition(qos, static_cast<uint32_t>(names.size()), names.data());
}

ros2::Qos ReadQos(const dds_qos_t* qos) {
  ros2::Qos read;
  dds_reliability_kind_t reliability = DDS_RELIABILITY_BEST_EFFORT;
  dds_duration_t max_blocking = 0;
  if (dds_qget_reliability(qos, &reliability, &max_blocking)) {
    read.reliable = reliability == DDS_RELIABILITY_RELIABLE;
  }
  dds_durability_kind_t durability = DDS_DURABILITY_VOLATILE;
  if (dds_qget_durability(qos, &durability)) {
    // Stronger kinds include what transient-local promises.
    read.transient_local = durability >= DDS_DURABILITY_TRANSIENT_LOCAL;
  }
  dds_history_kind_t history = DDS_HISTORY_KEEP_LAST;
  int32_t depth = 0;
  if (dds_qget_history(qos, &history, &depth)) {
    read.keep_all = history == DDS_HISTORY_KEEP_ALL;
    read.depth = read.keep_all ? 0 : static_cast<uint32_t>(std::max(depth, 0));
  }
  uint32_t count = 0;
  char** partitions = nullptr;
  if (dds_qget_partition(qos, &count, &partitions)) {
    for (uint32_t i = 0; i < count; ++i) {
      if (i < kPartitionsMax) read.partitions.push_back(ros2::Printable(partitions[i]));
      dds_free(partitions[i]);
    }
    dds_free(partitions);
  }
  return read;
}

std::string WhyUnreadable(const dds_qos_t* qos) {
  // Our readers ask for less than any writer offers in all that is ordered; what is left are kinds
  // that must be equal (DDS 1.4 §2.2.3.9) and encodings (DDS-XTypes 1.3 §7.6.3.1.1).
  dds_ownership_kind_t ownership = DDS_OWNERSHIP_SHARED;
  if (dds_qget_ownership(qos, &ownership) && ownership != DDS_OWNERSHIP_SHARED) {
    return "QoS: exclusive ownership";
  }
  uint32_t count = 0;
  dds_data_representation_id_t* offered = nullptr;
  if (!dds_qget_data_representation(qos, &count, &offered)) return {};
  // None = the first version of CDR. A writer sends in the first it lists.
  const int first = count == 0 ? DDS_DATA_REPRESENTATION_XCDR1 : offered[0];
  if (offered != nullptr) dds_free(offered);
  if (first == DDS_DATA_REPRESENTATION_XCDR1 || first == DDS_DATA_REPRESENTATION_XCDR2) return {};
  return absl::StrCat("QoS: data representation ", first, " is not known");
}

std::string ReadUserData(const dds_qos_t* qos) {
  void* value = nullptr;
  size_t size = 0;
  if (!dds_qget_userdata(qos, &value, &size) || value == nullptr) return {};
  std::string read(static_cast<const char*>(value), std::min(size, kUserDataBytesMax));
  dds_free(value);
  return read;
}

std::string ReadProperty(const dds_qos_t* qos, const char* name) {
  char* value = nullptr;
  if (!dds_qget_prop(qos, name, &value) || value == nullptr) return {};
  std::string read = ros2::Printable(value);
  dds_free(value);
  return read;
}

std::string UserDataField(absl::string_view user_data, absl::string_view key) {
  for (absl::string_view field : absl::StrSplit(user_data, ';')) {
    if (absl::ConsumePrefix(&field, key) && absl::ConsumePrefix(&field, "=")) {
      return std::string(field);
    }
  }
  return {};
}

}  // namespace rips::dds
