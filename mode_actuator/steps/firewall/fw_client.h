// The firewall steps of levels, carried out by rips-fw.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FW_CLIENT_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FW_CLIENT_H_

#include <sys/types.h>

#include <optional>
#include <string>
#include <utility>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/firewall/fw_message.h"
#include "mode_actuator/steps/port/firewall_control.h"
#include "services/local_socket/helper_door.h"

namespace rips::actuator {

// What a check or a drill waits for its answer.
inline constexpr absl::Duration kFwCheckTimeout = absl::Seconds(3);

// A connection for each request: rips-fw may be started by it, or anew between two.
class FwClient final : public FirewallControl {
 public:
  // `run_as`: the user that rips-fw runs as, if there is one.
  explicit FwClient(std::string socket_path, std::optional<uid_t> run_as = std::nullopt)
      : door_(std::move(socket_path), "rips-fw", run_as) {}

  // The steps are FirewallSteps.
  StepReading Enter(const Step& step, absl::Duration timeout, int retries,
                    const CancelFlag& cancel) override;
  StepReading Check(const Step& step, const CancelFlag& cancel) override;
  StepReading Drill(const Step& step, const CancelFlag& cancel) override;

  // Unavailable if rips-fw is not there or goes away, PermissionDenied if another process poses as
  // it, DeadlineExceeded, Cancelled, DataLoss if the answer is none. What rips-fw says is in the
  // response.
  absl::StatusOr<FwResponse> Call(const FwRequest& request, absl::Duration timeout,
                                  const CancelFlag& cancel) const;
  // As HelperDoor::Check.
  absl::Status CheckSocket() const { return door_.Check(); }

 private:
  StepReading CallOnce(FwVerb verb, const Step& step, const CancelFlag& cancel) const;

  const HelperDoor door_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FW_CLIENT_H_
