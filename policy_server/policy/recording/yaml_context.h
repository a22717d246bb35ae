// The `context` of the prototype's events as a graph; yaml_reader.h says how. Internal to this
// folder.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_CONTEXT_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_CONTEXT_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "absl/container/flat_hash_map.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/recording/yaml_tree.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::recording {

// Participants are made up: one a node. Inclusive, over the whole file.
inline constexpr size_t kYamlParticipantsMax = 65'536;
// Of one context. Inclusive; RosGraph has its own, lower limits, past which it is truncated.
inline constexpr size_t kYamlEndpointsMax = 65'536;

// Not thread-safe.
class YamlContexts {
 public:
  // The graph of one context, as upserts; what this file said before is kept for the GUIDs only.
  // InvalidArgument: another shape, a malformed name. ResourceExhausted: past a limit.
  absl::StatusOr<ros2::GraphDelta> Decode(const YamlNode& context);
  // First type of the topic in the context decoded last; empty = none.
  std::string TypeOf(const std::string& topic) const;

 private:
  class Builder;

  // By full name, and how many nodes of that name came before in the context.
  absl::flat_hash_map<std::pair<std::string, uint32_t>, ros2::Guid> participants_;
  absl::flat_hash_map<std::string, std::string> types_;
};

// "/name" for a name without any slash; else `name`.
std::string InRoot(const std::string& name);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_YAML_CONTEXT_H_
