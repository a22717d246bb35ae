#include "tests/support/robot_sim/bad_discovery.h"

#include <cstddef>
#include <cstdint>
#include <utility>

#include "absl/strings/string_view.h"
#include "services/ros2/cdr.h"
#include "services/ros2/discovery_info.h"

namespace rips::robot_sim {
namespace {

using ros2::CdrWriter;

// The message with gids of `gid_bytes` octets, one node, and list lengths of the caller's choice.
std::string Message(const ros2::Guid& participant, size_t gid_bytes, uint32_t nodes,
                    uint32_t readers, absl::string_view node_name) {
  std::string gid = participant.ToBytes();
  gid.resize(gid_bytes, '\0');
  CdrWriter out;
  out.Octets(gid);
  out.U32(nodes);
  out.String("/");
  out.String(node_name);
  out.U32(readers);
  out.Octets(gid);
  out.U32(0);
  return std::move(out).Finish();
}

}  // namespace

std::vector<BadDiscoveryMessage> BadDiscoveryMessages(const ros2::Guid& participant) {
  constexpr size_t kHumble = 24;
  constexpr size_t kOddGid = 20;
  constexpr size_t kTrailing = 64;
  constexpr size_t kEntityKindAt = 15;
  const std::string good = Message(participant, kHumble, 1, 1, "bad");
  ros2::Guid foreign = participant;
  foreign.bytes.at(4) ^= 0xff;
  ros2::NodeEntities ghost{.node_namespace = "/", .node_name = "ghost"};
  ghost.writers.push_back(foreign);
  ghost.writers.back().bytes.at(kEntityKindAt) = 0x03;
  return {
      {"header only", good.substr(0, ros2::kCdrHeaderBytes)},
      {"cut in a gid", good.substr(0, ros2::kCdrHeaderBytes + kHumble / 2)},
      {"cut in a name", good.substr(0, ros2::kCdrHeaderBytes + kHumble + 14)},
      {"20-byte gids", Message(participant, kOddGid, 1, 1, "bad")},
      {"node count past the end", Message(participant, kHumble, UINT32_MAX, 1, "bad")},
      {"reader count past the end", Message(participant, kHumble, 1, UINT32_MAX, "bad")},
      {"name that is no ROS name", Message(participant, kHumble, 1, 1, "b\x1b[31m d!")},
      {"bytes after the end", good + std::string(kTrailing, '\xff')},
      {"foreign gid",
       ros2::EncodeParticipantEntities({.participant = foreign, .nodes = {std::move(ghost)}})},
  };
}

}  // namespace rips::robot_sim
