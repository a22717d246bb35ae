// PartModes over the System Modes services of a ROS 2 robot.
//
// The mode manager's `success` means that it knows the name, not that the mode was reached, and
// what it infers can stay unknown for ever after its restart. So every order is read back:
//   manager  /part/get_state is active and /part/get_mode is the mode
//   parts    every node's /node/get_state and /node/get_parameters are as the SMH file says
// With Verify::kParts both are asked. The parts decide; the manager may be silent (no answer,
// state unknown, mode "" or "unknown") once kManagerSilence has passed, but must not name another
// mode. With Verify::kManager only the manager is asked.
#ifndef RIPS_MODE_ACTUATOR_SYSTEM_MODES_H_
#define RIPS_MODE_ACTUATOR_SYSTEM_MODES_H_

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/part_modes.h"
#include "mode_actuator/smh.h"
#include "services/base/clock.h"
#include "services/dds/participant.h"

namespace rips::actuator {

enum class Verify { kParts, kManager };

inline constexpr absl::Duration kOrderTimeout = absl::Seconds(1);        // one change_mode call
inline constexpr absl::Duration kReadTimeout = absl::Milliseconds(500);  // one get_* call
inline constexpr absl::Duration kReadPeriod = absl::Milliseconds(100);   // between two looks
inline constexpr absl::Duration kManagerSilence = absl::Milliseconds(500);
inline constexpr absl::Duration kProbeTime = absl::Seconds(3);  // all calls of a Probe
inline constexpr size_t kDetailPartsMax = 8;                    // parts named in one message

class SystemModes final : public PartModes {
 public:
  // (absolute part, mode), each once.
  using Targets = std::vector<std::pair<std::string, std::string>>;

  // Makes the clients of everything `targets` needs, so that calls find them matched. Enter and
  // Check know these targets only. NotFound if the SMH file lacks a part or mode. `participant` and
  // `clock` are not owned and outlive this; the clock must really pass.
  static absl::StatusOr<std::unique_ptr<SystemModes>> Create(const dds::Participant* participant,
                                                             const Smh& smh, Verify verify,
                                                             const Targets& targets,
                                                             const Clock* clock);
  ~SystemModes() override;

  ModeReading Enter(absl::string_view part, absl::string_view mode, absl::Duration timeout,
                    int retries, const CancelFlag& cancel) override;
  ModeReading Check(absl::string_view part, absl::string_view mode,
                    const CancelFlag& cancel) override;

  ModeReading Probe(absl::string_view part, absl::string_view mode,
                    const CancelFlag& cancel) override;

  // OK if the manager lists every target mode; Unavailable if it does not answer;
  // FailedPrecondition if it works with another SMH file. Same thread as Enter.
  absl::Status CheckAvailable();

 private:
  struct Part;
  struct Node;
  struct Target;
  struct View;
  class Impl;
  explicit SystemModes(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_SYSTEM_MODES_H_
