// rmw_dds_common/msg/ParticipantEntitiesInfo: which nodes a participant holds and which endpoints
// belong to each. Published latched by every ROS 2 process on `ros_discovery_info`; each message
// is the participant's whole state.
#ifndef RIPS_SERVICES_ROS2_DISCOVERY_INFO_H_
#define RIPS_SERVICES_ROS2_DISCOVERY_INFO_H_

#include <cstddef>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/ros2/guid.h"

namespace rips::ros2 {

// A gid is an octet array: the GUID, then zeros.
enum class GidBytes {
  k16 = 16,  // Iron and later
  k24 = 24,  // Foxy, Galactic, Humble
};

struct NodeEntities {
  std::string node_namespace;  // "/" or "/ns"
  std::string node_name;
  std::vector<Guid> readers;
  std::vector<Guid> writers;

  friend bool operator==(const NodeEntities&, const NodeEntities&) = default;
};

struct ParticipantEntities {
  Guid participant;
  std::vector<NodeEntities> nodes;
  GidBytes gid_bytes = GidBytes::k24;

  friend bool operator==(const ParticipantEntities&, const ParticipantEntities&) = default;
};

struct DiscoveryLimits {
  size_t nodes = 1'024;       // of one participant
  size_t endpoints = 16'384;  // readers and writers of one participant together
};

// Reads `payload` as both gid sizes, strictly; at most one fits, since 24-byte gids end in zeros
// where the other form has its node count. DataLoss if neither does, or past a limit. A node whose
// name or namespace is no valid ROS name is left out, so that it hides no other of its process;
// `misnamed`, if not null, takes how many are.
absl::StatusOr<ParticipantEntities> DecodeParticipantEntities(absl::string_view payload,
                                                              const DiscoveryLimits& limits = {},
                                                              size_t* misnamed = nullptr);

// Little endian, with encapsulation header. Decode gives `info` back.
std::string EncodeParticipantEntities(const ParticipantEntities& info);

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_DISCOVERY_INFO_H_
