// What no honest writer's sequence numbers do.
#ifndef RIPS_SENSOR_AGENT_MESSAGES_SEQUENCE_JUMP_H_
#define RIPS_SENSOR_AGENT_MESSAGES_SEQUENCE_JUMP_H_

#include <algorithm>
#include <cstdint>
#include <string>

#include "services/ros2/guid.h"

namespace rips::sensor {

// The numbers of this writer jumped: `detail` says from where to where.
struct SequenceJump {
  ros2::Guid writer;
  std::string detail;
};

// The first number of a writer that we see: its writer has been at it for 12 days at a million
// samples a second, 35 years at 1 kHz.
inline constexpr uint64_t kFirstNumberMax = uint64_t{1} << 40;
// Whatever the rate, so much may be missing; and a number may be so much lower than one before.
inline constexpr uint64_t kNumbersSlack = 10'000;
// Samples that a writer makes in a second, at most.
inline constexpr uint64_t kNumbersPerSecond = 1'000'000;

// How much a writer's numbers may rise within `elapsed_ns`.
inline uint64_t RiseMax(uint64_t per_second, int64_t elapsed_ns) {
  const uint64_t ms = static_cast<uint64_t>(std::max<int64_t>(elapsed_ns, 0)) / 1'000'000;
  return kNumbersSlack + per_second * ms / 1'000;
}

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_MESSAGES_SEQUENCE_JUMP_H_
