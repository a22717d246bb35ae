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
// With Fallback::kDirect a mode manager that fails is gone without. A step has timeout x (1 +
// retries); the nodes themselves are ordered (direct_modes.h) with what is left of it once
// | the mode manager                                      | at the latest                         |
// |-------------------------------------------------------|---------------------------------------|
// | is not there, or does not answer an order             | after kOrderTimeout                   |
// | refuses                                               | at once                               |
// | did not get the parts there, or names another mode    | before the last attempt; with one     |
// |                                                       | attempt at half of it                 |
// | failed the last time: it is told, not waited for      | at once                               |
// | left this mode kLeavesMax times in the last minute    | at once, and it is not told           |
// A part brought there so is held by its nodes alone: what the manager says does not count, until
// it agrees. Such a part is Degraded. A manager that comes back, or another in its place (its
// service has another GUID), is told once of the mode that is held.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_SYSTEM_MODES_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_SYSTEM_MODES_H_

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/port/part_modes.h"
#include "mode_actuator/steps/system_mode/direct_modes.h"
#include "mode_actuator/steps/system_mode/manager_client.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/base/clock.h"
#include "services/dds/participant.h"

namespace rips::actuator {

inline constexpr absl::Duration kManagerSilence = absl::Milliseconds(500);
// A manager that rests in another mode so long after an order has lost it (an order for the mode it
// infers at that moment does nothing, even if it is just leaving it): it is told again.
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
  ~SystemModes() override;

  ModeReading Enter(absl::string_view part, absl::string_view mode, absl::Duration timeout,
                    int retries, const CancelFlag& cancel) override;
  ModeReading Check(absl::string_view part, absl::string_view mode,
                    const CancelFlag& cancel) override;

  ModeReading Probe(absl::string_view part, absl::string_view mode,
                    const CancelFlag& cancel) override;

  PartReading Read(absl::string_view part, absl::Duration at_most,
                   const CancelFlag& cancel) override;

  // OK if the manager lists every target mode, and every node answers and is inactive or active.
  // Unavailable if somebody does not answer; FailedPrecondition if the manager works with another
  // SMH file, or a node is in a state the manager does nothing with. Same thread as Enter.
  absl::Status CheckAvailable();

  // What people must know although levels hold, one line for each part; and what CheckAvailable
  // found last. Same thread as Enter.
  std::vector<std::string> Degraded() const;

 private:
  class Impl;
  explicit SystemModes(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_SYSTEM_MODES_H_
