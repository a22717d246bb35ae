// The correlation header by which rmw_cyclonedds pairs a service reply with its request: 16 bytes
// between the encapsulation header and the message, in the payload's byte order. Being a multiple
// of 8 it leaves the alignment of the message unchanged.
#ifndef RIPS_SERVICES_ROS2_SERVICE_HEADER_H_
#define RIPS_SERVICES_ROS2_SERVICE_HEADER_H_

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::ros2 {

struct ServiceHeader {
  // Instance handle of the client's request writer; the server echoes it.
  uint64_t client_id = 0;
  // The client's own count; the server echoes it.
  int64_t sequence = 0;

  friend bool operator==(const ServiceHeader&, const ServiceHeader&) = default;
};

struct ServiceMessage {
  ServiceHeader header;
  // The message as an ordinary CDR payload, with encapsulation header.
  std::string payload;
};

// `payload` with `header` inserted. InvalidArgument if `payload` is no CDR payload.
absl::StatusOr<std::string> AddServiceHeader(absl::string_view payload,
                                             const ServiceHeader& header);

// Inverse. DataLoss if `payload` is too short or no CDR payload.
absl::StatusOr<ServiceMessage> SplitServiceHeader(absl::string_view payload);

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_SERVICE_HEADER_H_
