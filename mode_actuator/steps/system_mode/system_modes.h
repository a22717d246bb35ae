// PartModes over the System Modes services of a ROS 2 robot, or over the nodes' own services.
//
// The mode manager's `success` means that it knows the name, not that the mode was reached, and
// what it infers can stay unknown for ever after its restart. So every order is read back:
//   manager  /part/get_state is active and /part/get_mode is the mode
//   parts    every node's /node/get_state and /node/get_parameters are as the SMH file says
// With Verify::kParts both are asked. The parts decide; once kManagerSilence has passed the manager
// may be silent (no answer, state unknown, mode "" or "unknown") or still be in transition, but must
// not name another mode. With Verify::kManager only the manager is asked.
//
// Only the one server there is counts. While several participants offer a service of a node,
// nothing of the node is read, so its part is not reached; of several mode managers none answers,
// so the nodes decide, or, with Verify::kManager, the part is not reached. Orders go to all of
// them. A server that died is one of them until its lease ends.
//
// With Fallback::kDirect a mode manager that fails is gone without. A step has timeout x (1 +
// retries); the nodes themselves are ordered (direct_modes.h) with what is left of it once
// | the mode manager                                      | at the latest                         |
// |-------------------------------------------------------|---------------------------------------|
// | is not there, or does not answer an order             | after kOrderTimeout                   |
// | refuses; there are several                            | at once                               |
// | did not get the parts there, or names another mode    | before the last attempt; with one     |
// |                                                       | attempt at half of it                 |
// | failed the last time: ordered, but not waited for     | at once                               |
// | left this mode kLeavesMax times in the last minute    | at once, without the manager          |
// A part brought there so is held by its nodes alone: what the manager says does not count, until
// it agrees. Such a part is Degraded. A manager that comes back, or another in its place (its
// service has another GUID), is ordered once to the mode that is held.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_SYSTEM_MODES_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_SYSTEM_MODES_H_

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/port/part_modes.h"
#include "mode_actuator/steps/system_mode/direct_modes.h"
#include "mode_actuator/steps/system_mode/manager_client.h"
#include "mode_actuator/steps/system_mode/mode_hold.h"
#include "mode_actuator/steps/system_mode/node_client.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/base/clock.h"
#include "services/dds/participant.h"

namespace rips::actuator {

inline constexpr absl::Duration kManagerSilence = absl::Milliseconds(500);
// A manager that rests in another mode so long after an order has lost it (an order for the mode it
// infers at that moment does nothing, even if it is just leaving it): it is ordered again.
inline constexpr absl::Duration kReorderAfter = absl::Milliseconds(500);
// After an order that was given up half-way, the next one counts as carried out only when it is
// seen so for this long: the first may still take effect.
inline constexpr absl::Duration kFlipTime = absl::Milliseconds(500);
inline constexpr absl::Duration kProbeTime = absl::Seconds(3);  // all questions of one Probe
// One question of Read: the time is short, a node that hangs must not use it up, and Read is
// repeated.
inline constexpr absl::Duration kSurveyReadTimeout = absl::Milliseconds(100);

class SystemModes final : public PartModes {
 public:
  // (absolute part, mode), each once.
  using Targets = std::vector<std::pair<std::string, std::string>>;

  // Makes the clients of everything `targets` needs, so that calls find them matched. Enter and
  // Check know these targets only. NotFound if the SMH file lacks a part or mode; InvalidArgument
  // if `options` contradict themselves. `participant` and `clock` are not owned and outlive this;
  // the clock must really pass.
  static absl::StatusOr<std::unique_ptr<SystemModes>> Create(const dds::Participant* participant,
                                                             const Smh& smh,
                                                             const ModesOptions& options,
                                                             const Targets& targets,
                                                             const Clock* clock);

  ModeReading Enter(absl::string_view part, absl::string_view mode, absl::Duration timeout,
                    int retries, const CancelFlag& cancel) override;
  ModeReading Check(absl::string_view part, absl::string_view mode,
                    const CancelFlag& cancel) override;

  ModeReading Probe(absl::string_view part, absl::string_view mode,
                    const CancelFlag& cancel) override;

  PartReading Read(absl::string_view part, absl::Duration at_most,
                   const CancelFlag& cancel) override;

  // OK if the manager lists every target mode, and every node answers and is inactive or active.
  // Unavailable if a service does not answer; FailedPrecondition if the manager works with another
  // SMH file, or a node is in a state the manager does nothing with. Same thread as Enter.
  absl::Status CheckAvailable();

  // Warnings although levels hold, one line for each part; and what CheckAvailable
  // found last. Same thread as Enter.
  std::vector<std::string> Degraded() const;

 private:
  struct Part {
    explicit Part(const std::string& name) : hold(name) {}

    std::unique_ptr<ManagerClient> manager;  // null with Backend::kDirect
    std::vector<std::string> modes;          // that levels use
    ModeHold hold;
    std::string unfinished;  // mode of the last order to the manager, if it was not read back
  };
  struct Task;
  struct View;
  struct Attempt;

  SystemModes(const dds::Participant* participant, const ModesOptions& options, const Clock* clock)
      : participant_(participant), options_(options), clock_(clock) {}

  absl::Status Add(const Smh& smh, const std::string& part, const std::string& mode);
  bool may_go_direct() const {
    return options_.backend == Backend::kDirect || options_.fallback == Fallback::kDirect;
  }
  View Poll(Part& part, absl::string_view mode, const std::vector<ExpectedPart>& expected,
            const CancelFlag& cancel);
  // `held_by_parts`: the manager does not count.
  absl::Status Verdict(const View& view, bool silence_allowed, bool held_by_parts) const;
  ModeReading ThroughManager(Task& task, absl::Duration timeout, int attempts);
  // False if the manager did not take the order; `attempt` says why.
  bool OrderManager(Task& task, int64_t end_ns, Attempt& attempt);
  // One attempt, until `end_ns`.
  Attempt AskManager(Task& task, int64_t end_ns);
  // Orders the nodes until the end of `task`; `why` not through the manager.
  ModeReading Direct(Task& task, std::string why);
  // What the manager must hear, and what is known of it, after a part in `mode` was polled.
  void Follow(Part& part, absl::string_view mode, const View& view, ModeReading& reading);
  absl::Status CheckManager(const std::string& name, Part& part,
                            const std::vector<std::string>& modes) const;
  static absl::Status CheckNode(const std::string& name, NodeClient& node);
  // What `node` must be like when `part` is in `mode`; null if that asks nothing of it.
  const ExpectedPart* Expected(const std::string& part, const std::string& mode,
                               const std::string& node) const;
  // Leaves in `modes` of `part` those with which `node` agrees. False if it does not answer.
  bool KeepAgreeing(const std::string& part, const std::string& node,
                    std::vector<std::string>& modes);
  int64_t NowNs() const { return clock_->Now().boottime_ns; }

  const dds::Participant* const participant_;  // Not owned; outlives this.
  const ModesOptions options_;
  const Clock* const clock_;  // Not owned; outlives this.
  absl::btree_map<std::string, Part> parts_;
  NodeClients nodes_;
  absl::btree_map<std::pair<std::string, std::string>, std::vector<ExpectedPart>> targets_;
  std::vector<std::string> unavailable_;  // what CheckAvailable found
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_SYSTEM_MODES_H_
