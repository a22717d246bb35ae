// Between rips-actuator and rips-fw: rips.v1.FwRequest and rips.v1.FwResponse of helper.proto, one
// packet each way.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FW_MESSAGE_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FW_MESSAGE_H_

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/decide/drop_watch.h"
#include "mode_actuator/decide/level_plan.h"

namespace rips::actuator {

inline constexpr size_t kFwPacketBytesMax = 8 << 10;
// Of each text of a response; longer ones are cut.
inline constexpr size_t kFwTextBytesMax = 2048;

enum class FwVerb {
  kEnter = 1,  // do it and read it back
  kCheck,      // look whether it is so, and renew its time
  kTry,        // look whether it could be done; nothing is loaded
  kStatus,     // what is in force; no step
};

struct FwRequest {
  FwVerb verb = FwVerb::kStatus;
  FirewallStep step;
  friend bool operator==(const FwRequest&, const FwRequest&) = default;
};

struct FwResponse {
  absl::Status status;
  std::string observed;
  std::string note;
  // Of a check.
  std::optional<DropCount> dropped;
  friend bool operator==(const FwResponse&, const FwResponse&) = default;
};

// A request of the limits of level_plan.h and target.h fits into kFwPacketBytesMax.
std::string EncodeFwRequest(const FwRequest& request);
// InvalidArgument for anything that EncodeFwRequest does not give: unknown, missing, repeated or
// misplaced fields, too many targets, a time that is none.
absl::StatusOr<FwRequest> DecodeFwRequest(absl::string_view packet);

// Its texts become one line of printable ASCII each.
std::string EncodeFwResponse(const FwResponse& response);
// DataLoss for anything else.
absl::StatusOr<FwResponse> DecodeFwResponse(absl::string_view packet);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FW_MESSAGE_H_
