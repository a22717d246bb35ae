// What an actuator must remember across a restart, and its form on disk:
//   rips-actuator-state 1
//   mark 3.17
//   decided ALERT            (empty: nothing decided)
//   effective COMPROMISED
//   highest_term 3
//   crc 1a2b3c4d             (CRC-32, IEEE 802.3, of all bytes before this line; 8 hex digits)
// every line ended by a line feed, nothing before or after.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_ACTUATOR_STATE_H_
#define RIPS_MODE_ACTUATOR_DECIDE_ACTUATOR_STATE_H_

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/base/decision_id.h"

namespace rips::actuator {

inline constexpr size_t kStateBytesMax = 4096;

struct ActuatorState {
  DecisionId decision_id;  // of the newest decision held; none = nothing decided
  std::string decided;     // level name; empty exactly when decision_id is none
  std::string effective;   // level name; not empty
  uint64_t highest_term = 0;
  friend bool operator==(const ActuatorState&, const ActuatorState&) = default;
};

// Level names must hold no line feed, as the configuration ensures.
std::string EncodeState(const ActuatorState& state);

// Inverse. DataLoss for anything EncodeState does not give, byte for byte.
absl::StatusOr<ActuatorState> DecodeState(absl::string_view bytes);

// CRC-32 as in IEEE 802.3 and zlib; of "123456789" it is cbf43926.
uint32_t Crc32(absl::string_view bytes);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_ACTUATOR_STATE_H_
