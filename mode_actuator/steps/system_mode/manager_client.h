// Queries and orders to the mode manager for one part.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MANAGER_CLIENT_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MANAGER_CLIENT_H_

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/system_mode/node_client.h"
#include "services/dds/participant.h"
#include "services/dds/service_client.h"
#include "services/ros2/guid.h"

namespace rips::actuator {

inline constexpr absl::Duration kOrderTimeout = absl::Seconds(1);  // one change_mode call

// What it says of the part.
struct ManagerView {
  bool answers = false;  // both questions
  bool agrees = false;   // active, and in the mode asked for
  // It contradicts nothing: no answer, state unknown, mode "" or "unknown"; or it names the mode, in
  // whatever state.
  bool silent = true;
  bool elsewhere = false;  // active, and in another mode: it is not on its way
  std::string named;       // the mode it names, as it was sent; empty if none
  std::string observed;    // the same, safe to print
  std::string says = "the mode manager does not answer";  // a message
};

// One thread at a time. Must not outlive its participant.
class ManagerClient {
 public:
  static absl::StatusOr<std::unique_ptr<ManagerClient>> Create(const dds::Participant& participant,
                                                               const std::string& part);

  // Its answer to the order; false = it refuses. DeadlineExceeded after `timeout`, or kOrderTimeout
  // if that is shorter, whether it is not there or does not answer. FailedPrecondition, naming
  // participants, if there are several managers: all of them have the order then.
  absl::StatusOr<bool> Order(absl::string_view mode, absl::Duration timeout);
  // As above, but does not wait for one that is not there: Unavailable.
  absl::StatusOr<bool> OrderIfThere(absl::string_view mode);
  // `timeout` of each of its two calls.
  ManagerView Poll(absl::string_view mode, absl::Duration timeout = kReadTimeout);
  absl::StatusOr<std::vector<std::string>> AvailableModes();

  // The endpoint that takes orders: another one after a restart. nullopt = there is none, or there
  // are several.
  std::optional<ros2::Guid> server() const;

 private:
  ManagerClient() = default;

  std::unique_ptr<dds::ServiceClient> change_mode_;
  std::unique_ptr<dds::ServiceClient> get_mode_;
  std::unique_ptr<dds::ServiceClient> get_state_;
  std::unique_ptr<dds::ServiceClient> get_available_modes_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_MANAGER_CLIENT_H_
