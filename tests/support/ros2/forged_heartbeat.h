// What anybody on the bus can send in the name of another. Test code only.
#ifndef RIPS_TESTS_SUPPORT_ROS2_FORGED_HEARTBEAT_H_
#define RIPS_TESTS_SUPPORT_ROS2_FORGED_HEARTBEAT_H_

#include <cstdint>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "services/ros2/guid.h"

namespace rips::dds {

// A datagram with a HEARTBEAT of `writer` for the readers in the participant `victim`: what
// `writer` sent or will send below the number 2^40 is gone (DDSI-RTPS 2.5 §8.3.8.6).
std::string ForgedHeartbeat(const ros2::Guid& writer, const ros2::Guid& victim);

// Sends a datagram to every participant of the domain on the loopback interface. Unavailable with
// the system's error.
absl::Status SendToDomain(uint32_t domain, absl::string_view datagram);

}  // namespace rips::dds

#endif  // RIPS_TESTS_SUPPORT_ROS2_FORGED_HEARTBEAT_H_
