// The lifecycle and parameter services of one ROS 2 node: what it is, and orders to it.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_NODE_CLIENT_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_NODE_CLIENT_H_

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/dds/participant.h"
#include "services/dds/service_client.h"

namespace rips::actuator {

inline constexpr absl::Duration kReadTimeout = absl::Milliseconds(500);  // one get_* call
// One change_state or set_parameters call: the node answers when its callback is done.
inline constexpr absl::Duration kNodeOrderTimeout = absl::Seconds(1);

// lifecycle_msgs/msg/Transition and State, as numbered on the wire.
inline constexpr uint8_t kTransitionConfigure = 1;
inline constexpr uint8_t kTransitionActivate = 3;
inline constexpr uint8_t kTransitionDeactivate = 4;
inline constexpr uint8_t kStateUnconfigured = 1;
inline constexpr uint8_t kStateFinalized = 4;

// "inactive"; "in transition (13)".
std::string StateName(uint8_t id);

// The next transition of a node in `state` that shall be `wanted`; 0 if it is there, is on its way,
// or cannot get there.
uint8_t NextTransition(uint8_t state, PartState wanted);

// What a look at one node gave.
struct NodeView {
  bool answers = false;
  // Several servers offer a service that the look asks: what they say counts for nothing.
  bool ambiguous = false;
  uint8_t state = 0;
  bool state_ok = false;
  // Each question that the look asks was answered.
  bool complete = false;
  // Empty if the node is as expected, else what it is instead: `/camera is active, expected
  // inactive`.
  std::string wrong;
};

// A call to `client` that does not wait for a server that is not there: Unavailable. Otherwise as
// ServiceClient::Call; FailedPrecondition, naming participants, if several servers offer it.
absl::StatusOr<std::string> AskIfThere(dds::ServiceClient& client, const std::string& request,
                                       absl::Duration timeout = kReadTimeout,
                                       dds::IfSeveral if_several = dds::IfSeveral::kAskNone);

// One thread at a time. Must not outlive its participant.
class NodeClient {
 public:
  static absl::StatusOr<std::unique_ptr<NodeClient>> Create(const dds::Participant& participant,
                                                            const std::string& name);

  // Its lifecycle state. Unavailable if no node answers; FailedPrecondition as AskIfThere.
  absl::StatusOr<uint8_t> State(absl::Duration timeout = kReadTimeout);
  // Looks at state and, where some are expected, parameters. `timeout` of each call.
  NodeView Poll(const ExpectedPart& expected, absl::Duration timeout = kReadTimeout);

  // FailedPrecondition if the node refuses, or if several servers offer the service: then all of
  // them have the order. Unavailable and DeadlineExceeded as calls give them.
  absl::Status Transition(uint8_t transition);
  // All or none of them.
  absl::Status SetParameters(const ParameterMap& parameters);

 private:
  explicit NodeClient(std::string name) : name_(std::move(name)) {}
  void JudgeParameters(const ExpectedPart& expected, absl::Duration timeout, NodeView& view);
  // What is deaf to one client of ours may be so to all: see ServiceClient::Suspect.
  void SuspectAll();

  const std::string name_;
  std::unique_ptr<dds::ServiceClient> get_state_;
  std::unique_ptr<dds::ServiceClient> get_parameters_;
  std::unique_ptr<dds::ServiceClient> change_state_;
  std::unique_ptr<dds::ServiceClient> set_parameters_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_NODE_CLIENT_H_
