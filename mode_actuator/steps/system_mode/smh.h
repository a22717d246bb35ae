// The System Modes (SMH) file: which nodes a mode wants active, and with which parameter values.
// Text in, checked structure out; nothing here touches a robot.
//
// The format is that of micro-ROS `system_modes`. The upstream parser accepts files that make its
// mode manager crash or never reach a mode, so this one is stricter. It refuses:
//  - a part that a mode names and that has no block of its own (the mode manager ends with
//  SIGSEGV);
//  - a block without modes, or whose first mode is not `__DEFAULT__`;
//  - a mode of a node without parameters, or with a parameter `__DEFAULT__` does not have;
//  - a state other than `active` and `inactive` (upstream reads `ACTIVE` as "unknown");
//  - `active.MODE` of a mode the part does not have; a system that contains itself;
//  - rules (`if_target`, `if_part`, `new_target`) that name what is not there.
// `parts:` is ignored, as upstream does: the parts of a system are the keys of its `__DEFAULT__`. A
// list that differs from them is a warning.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_SMH_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_SMH_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/ros2/parameter_messages.h"

namespace rips::actuator {

inline constexpr absl::string_view kDefaultMode = "__DEFAULT__";
inline constexpr size_t kSmhBytesMax = 1 << 20;
inline constexpr size_t kSmhNodesMax = 100'000;  // YAML nodes visited, aliases counted each time
inline constexpr size_t kSmhProblemsMax = 50;    // reported in one status

// Primary lifecycle states (lifecycle_msgs/msg/State), as numbered on the wire.
enum class PartState : uint8_t { kInactive = 2, kActive = 3 };

// Name with dots -> value: bool, int64_t, double or std::string (what upstream can compare); a
// quoted scalar is a string.
using ParameterMap = absl::btree_map<std::string, ros2::ParameterValue>;

struct PartTarget {
  PartState state = PartState::kActive;
  std::string mode;  // `__DEFAULT__` unless the file says `active.MODE`; empty when inactive
  friend bool operator==(const PartTarget&, const PartTarget&) = default;
};

// Part names are absolute everywhere: `/safety`, `/ns/camera`.
struct SmhSystem {
  std::vector<std::string> parts;  // in file order; each is in `systems` or `nodes`
  // mode -> part -> target; complete: what a mode leaves out is taken from `__DEFAULT__`.
  absl::btree_map<std::string, absl::btree_map<std::string, PartTarget>> modes;
  absl::btree_map<std::string, std::string> places;  // mode -> "NAME:LINE:COLUMN"
};

struct SmhNode {
  // mode -> parameters; complete, as above.
  absl::btree_map<std::string, ParameterMap> modes;
};

// What one node must look like for a mode to be reached.
struct ExpectedPart {
  std::string node;
  PartState state = PartState::kActive;
  ParameterMap parameters;  // empty when inactive
};

struct Smh {
  absl::btree_map<std::string, SmhSystem> systems;
  absl::btree_map<std::string, SmhNode> nodes;
  // "NAME:LINE:COLUMN: text": legal, but worth a line in the log (rules that fight an order, names
  // under `parts` that are not those of the modes).
  std::vector<std::string> warnings;

  // Every node under `part` (a system or a node) when `part` is in `mode`, sorted by name; a node
  // reached twice must agree. NotFound for an unknown part or mode; FailedPrecondition if two
  // systems want different things of one node.
  absl::StatusOr<std::vector<ExpectedPart>> Expected(absl::string_view part,
                                                     absl::string_view mode) const;
};

// InvalidArgument lists every problem and then every warning, one per line, as
// "NAME:LINE:COLUMN: text" (both 1-based).
absl::StatusOr<Smh> ParseSmh(absl::string_view text, absl::string_view name = "smh.yaml");

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_SMH_H_
