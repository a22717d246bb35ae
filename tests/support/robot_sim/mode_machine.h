// The modes of a simulated robot: what System Modes' mode_manager and the lifecycle nodes under it
// would do, as a state machine without threads, clocks or DDS.
//
// A request is answered at once and takes effect later (`transition_ns` after it), all parts
// together. As in the original, asking for the mode that is inferred now is answered with success
// and changes nothing, not even a transition that is under way; and a node that is unconfigured or
// whose transition fails stays as it is, without a second try.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_MODE_MACHINE_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_MODE_MACHINE_H_

#include <cstdint>
#include <set>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/steps/system_mode/smh.h"

namespace rips::robot_sim {

// How the mode manager treats change_mode.
enum class ManagerConduct {
  kHonest,
  kLie,      // answers success and does nothing; get_mode tells the truth
  kDeceive,  // the same, and get_mode and get_state claim that the mode was reached
  kRefuse,   // answers failure
  kPull,     // honest, but leaves mode `pull_from` for `pull_to` as rules would
  kAbsent,   // there is no mode manager
};

// lifecycle_msgs/msg/State and its transition states, as numbered on the wire.
enum class Lifecycle : uint8_t {
  kUnknown = 0,
  kUnconfigured = 1,
  kInactive = 2,
  kActive = 3,
  kActivating = 13,
};

// lifecycle_msgs/msg/Transition, as numbered on the wire.
inline constexpr uint8_t kTransitionConfigure = 1;
inline constexpr uint8_t kTransitionCleanup = 2;
inline constexpr uint8_t kTransitionActivate = 3;
inline constexpr uint8_t kTransitionDeactivate = 4;

// "inactive", as lifecycle_msgs labels it.
absl::string_view Label(Lifecycle state);

struct NodeState {
  bool active = true;
  // Else it is `unconfigured`, and the mode manager does nothing with it.
  bool configured = true;
  // Its transitions fail, and it takes no parameters.
  bool stuck = false;
  // It publishes whatever its state is, as if another answered for it.
  bool goes_on = false;
  // Keeps its value, as the parameters do, while the node is inactive.
  std::string mode;
  actuator::ParameterMap parameters;
};

struct ModeMachineOptions {
  std::string system = "/safety";
  int64_t transition_ns = 150'000'000;
  ManagerConduct conduct = ManagerConduct::kHonest;
  // kPull: `pull_ns` after `pull_from` is reached.
  std::string pull_from;
  std::string pull_to = std::string(actuator::kDefaultMode);
  int64_t pull_ns = 1'000'000'000;
};

// Not thread-safe. Times are nanoseconds of one monotonic clock.
class ModeMachine {
 public:
  // Starts in `__DEFAULT__`. NotFound if the file has no such system; InvalidArgument if one of its
  // parts is not a node.
  static absl::StatusOr<ModeMachine> Create(actuator::Smh smh, ModeMachineOptions options);

  // The answer of PART/change_mode; `part` is the system or one of its nodes.
  bool ChangeMode(absl::string_view part, absl::string_view mode, int64_t now_ns);
  // The answer of NODE/change_state: false if the transition does not start from the node's state,
  // or the node is stuck. Takes effect at once.
  bool ChangeState(absl::string_view node, uint8_t transition);
  // The answer of NODE/set_parameters_atomically: empty, or why not. All must be declared, with the
  // type they have. The node is then in the mode whose parameters these are, or in none.
  std::string SetParameters(absl::string_view node, const actuator::ParameterMap& parameters);

  // What a test does to the robot.
  void SetConduct(ManagerConduct conduct) { options_.conduct = conduct; }
  void SetPull(absl::string_view from, absl::string_view to);
  void SetStuck(absl::string_view node, bool stuck) { nodes_.at(std::string(node)).stuck = stuck; }
  void SetGoesOn(absl::string_view node, bool on) { nodes_.at(std::string(node)).goes_on = on; }
  // Back to `unconfigured`.
  void Unconfigure(absl::string_view node);
  // As after the mode manager's restart: what was ordered is forgotten, and the system's state and
  // mode are not known until each of its nodes has made a transition.
  void ForgetModes();
  // The manager's file has no such mode of the system any more.
  void RemoveMode(absl::string_view mode) { removed_.insert(std::string(mode)); }
  void RestoreModes() { removed_.clear(); }
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
  void PullIfRuled(int64_t now_ns);

  actuator::Smh smh_;
  ModeMachineOptions options_;
  absl::btree_map<std::string, NodeState> nodes_;
  absl::btree_map<std::string, Pending> pending_;  // by part
  std::string target_;                             // of the system; wins if several modes fit
  std::set<std::string> not_inferred_;             // nodes; see ForgetModes
  std::set<std::string> removed_;                  // modes
  int64_t pull_at_ns_ = 0;                         // 0 = nothing to pull
  std::string claimed_;                            // kDeceive: what was asked for last
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_MODE_MACHINE_H_
