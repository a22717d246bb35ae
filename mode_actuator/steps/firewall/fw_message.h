// What rips-actuator and rips-fw say to each other: one packet each way, lines of text.
//
//   rips-fw 1                  rips-fw 1
//   verb enter                 code 0
//   kind isolate_hosts         observed firewall=2 isolated
//   target 10.0.0.7            note ...
//   for_ms 600000
//
// Text of nft never crosses: a level's rules are named by their file.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FW_MESSAGE_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FW_MESSAGE_H_

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/decide/level_plan.h"

namespace rips::actuator {

inline constexpr size_t kFwPacketBytesMax = 8 << 10;
// Of each text of a response; longer ones are cut.
inline constexpr size_t kFwTextBytesMax = 2048;
inline constexpr absl::Duration kFirewallForMax = absl::Hours(24);

enum class FwVerb {
  kEnter,   // do it and read it back
  kCheck,   // look whether it is so, and renew its time
  kTry,     // look whether it could be done; nothing is loaded
  kStatus,  // what is in force; no step
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
  friend bool operator==(const FwResponse&, const FwResponse&) = default;
};

// A request of the limits of level_plan.h and target.h fits into kFwPacketBytesMax.
std::string EncodeFwRequest(const FwRequest& request);
// InvalidArgument for anything that EncodeFwRequest does not print: unknown, repeated, missing or
// out of place lines, too many targets, a time that is none.
absl::StatusOr<FwRequest> DecodeFwRequest(absl::string_view packet);

std::string EncodeFwResponse(const FwResponse& response);
// DataLoss for anything else.
absl::StatusOr<FwResponse> DecodeFwResponse(absl::string_view packet);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FW_MESSAGE_H_
