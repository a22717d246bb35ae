// The modes of a simulated robot: what System Modes' mode_manager and the lifecycle nodes under it
// would do, as a state machine without threads, clocks or DDS.
//
// A request is answered at once and takes effect later (`transition_ns` after it), all parts
// together. As in the original, asking for the mode that is inferred now is answered with success
// and changes nothing, not even a transition that is under way.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_MODE_MACHINE_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_MODE_MACHINE_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/modes/smh.h"

namespace rips::robot_sim {

// How the mode manager treats change_mode.
enum class ManagerConduct {
  kHonest,
  kLie,      // answers success and does nothing; get_mode tells the truth
  kDeceive,  // the same, and get_mode and get_state claim that the mode was reached
  kRefuse,   // answers failure
  kAbsent,   // there is no mode manager
};

// lifecycle_msgs/msg/State and its transition states, as numbered on the wire.
enum class Lifecycle : uint8_t { kUnknown = 0, kInactive = 2, kActive = 3, kActivating = 13 };

// lifecycle_msgs/msg/Transition, as numbered on the wire.
inline constexpr uint8_t kTransitionActivate = 3;
inline constexpr uint8_t kTransitionDeactivate = 4;

// "inactive", as lifecycle_msgs labels it.
absl::string_view Label(Lifecycle state);

struct NodeState {
  bool active = true;
  // Keeps its value, as the parameters do, while the node is inactive.
  std::string mode;
  actuator::ParameterMap parameters;
};

struct ModeMachineOptions {
  std::string system = "/safety";
  int64_t transition_ns = 150'000'000;
  ManagerConduct conduct = ManagerConduct::kHonest;
};

// Not thread-safe. Times are nanoseconds of one monotonic clock.
class ModeMachine {
 public:
  // Starts in `__DEFAULT__`. NotFound if the file has no such system; InvalidArgument if one of its
  // parts is not a node.
  static absl::StatusOr<ModeMachine> Create(actuator::Smh smh, ModeMachineOptions options);

  // The answer of PART/change_mode; `part` is the system or one of its nodes.
  bool ChangeMode(absl::string_view part, absl::string_view mode, int64_t now_ns);
  // The answer of NODE/change_state: false unless the transition is activate or deactivate and
  // starts from the node's state. Takes effect at once.
  bool ChangeState(absl::string_view node, uint8_t transition);
  // Applies what is due. True if something was.
  bool Advance(int64_t now_ns);

  // The answer of PART/get_mode: "" if no mode fits (or the node is inactive), "unknown" for an
  // unknown part.
  std::string Mode(absl::string_view part) const;
  // The system's mode by what its parts do, whatever the manager claims; "" if none fits.
  std::string TrueMode() const;
  // The answer of PART/get_state.
  Lifecycle State(absl::string_view part) const;
  // The answer of PART/get_available_modes: sorted, empty for an unknown part.
  std::vector<std::string> AvailableModes(absl::string_view part) const;

  const std::string& system() const { return options_.system; }
  // By full name.
  const absl::btree_map<std::string, NodeState>& nodes() const { return nodes_; }

 private:
  struct Pending {
    std::string mode;
    int64_t due_ns = 0;
  };

  ModeMachine(actuator::Smh smh, ModeMachineOptions options);
  void Apply(absl::string_view part, absl::string_view mode);
  void SetNode(absl::string_view node, const actuator::PartTarget& target);
  bool Fits(absl::string_view mode) const;

  actuator::Smh smh_;
  ModeMachineOptions options_;
  absl::btree_map<std::string, NodeState> nodes_;
  absl::btree_map<std::string, Pending> pending_;  // by part
  std::string target_;                             // of the system; wins if several modes fit
  std::string claimed_;                            // kDeceive: what was asked for last
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_MODE_MACHINE_H_
