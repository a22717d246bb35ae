#include "services/ros2/discovery_info.h"

#include <algorithm>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2/cdr.h"
#include "services/ros2/ros_name.h"

namespace rips::ros2 {
namespace {

// A node on the wire: two empty strings and two empty sequences, each a 4-byte length.
constexpr size_t kNodeBytesMin = 16;

Guid ReadGid(CdrReader& reader, GidBytes gid_bytes) {
  const absl::string_view bytes = reader.Octets(static_cast<size_t>(gid_bytes));
  Guid guid;
  if (!reader.ok()) return guid;
  std::copy_n(bytes.begin(), guid.bytes.size(), guid.bytes.begin());
  const absl::string_view rest = bytes.substr(guid.bytes.size());
  if (rest.find_first_not_of('\0') != absl::string_view::npos) {
    reader.Fail("a gid does not end in zeros");
  }
  return guid;
}

std::vector<Guid> ReadGids(CdrReader& reader, GidBytes gid_bytes, size_t limit) {
  std::vector<Guid> gids(reader.Count(static_cast<size_t>(gid_bytes), limit));
  for (Guid& gid : gids) gid = ReadGid(reader, gid_bytes);
  return gids;
}

absl::StatusOr<ParticipantEntities> DecodeAs(absl::string_view payload, GidBytes gid_bytes,
                                             const DiscoveryLimits& limits) {
  // Of any length that fits: a name that is too long is one that no node has.
  CdrReader reader(payload, {.string_bytes = payload.size()});
  ParticipantEntities info;
  info.gid_bytes = gid_bytes;
  info.participant = ReadGid(reader, gid_bytes);
  info.nodes.resize(reader.Count(kNodeBytesMin, limits.nodes));
  size_t endpoints_left = limits.endpoints;
  for (NodeEntities& node : info.nodes) {
    node.node_namespace = std::string(reader.String());
    node.node_name = std::string(reader.String());
    node.readers = ReadGids(reader, gid_bytes, endpoints_left);
    endpoints_left -= node.readers.size();
    node.writers = ReadGids(reader, gid_bytes, endpoints_left);
    endpoints_left -= node.writers.size();
    if (!reader.ok()) break;
  }
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return info;
}

bool IsNamed(const NodeEntities& node) {
  if (node.node_namespace != "/" && !ValidateNodeName(node.node_namespace).ok()) return false;
  if (absl::StrContains(node.node_name, '/')) return false;
  return ValidateNodeName(JoinNodeName(node.node_namespace, node.node_name)).ok();
}

void WriteGid(CdrWriter& writer, const Guid& guid, GidBytes gid_bytes) {
  writer.Octets(guid.ToBytes());
  writer.Octets(std::string(static_cast<size_t>(gid_bytes) - guid.bytes.size(), '\0'));
}

void WriteGids(CdrWriter& writer, const std::vector<Guid>& gids, GidBytes gid_bytes) {
  writer.U32(static_cast<uint32_t>(gids.size()));
  for (const Guid& gid : gids) WriteGid(writer, gid, gid_bytes);
}

}  // namespace

absl::StatusOr<ParticipantEntities> DecodeParticipantEntities(absl::string_view payload,
                                                              const DiscoveryLimits& limits,
                                                              size_t* misnamed) {
  absl::StatusOr<ParticipantEntities> info = DecodeAs(payload, GidBytes::k24, limits);
  if (!info.ok()) {
    const absl::Status as_24 = info.status();
    info = DecodeAs(payload, GidBytes::k16, limits);
    if (!info.ok()) {
      return absl::DataLossError(absl::StrCat("with 24-byte gids: ", as_24.message(),
                                              "; with 16-byte gids: ", info.status().message()));
    }
  }
  const size_t dropped =
      std::erase_if(info->nodes, [](const auto& each) { return !IsNamed(each); });
  if (misnamed != nullptr) *misnamed = dropped;
  return info;
}

std::string EncodeParticipantEntities(const ParticipantEntities& info) {
  CdrWriter writer;
  WriteGid(writer, info.participant, info.gid_bytes);
  writer.U32(static_cast<uint32_t>(info.nodes.size()));
  for (const NodeEntities& node : info.nodes) {
    writer.String(node.node_namespace);
    writer.String(node.node_name);
    WriteGids(writer, node.readers, info.gid_bytes);
    WriteGids(writer, node.writers, info.gid_bytes);
  }
  return std::move(writer).Finish();
}

}  // namespace rips::ros2
