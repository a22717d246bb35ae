// RTPS GUID: names one DDS participant or endpoint (DDSI-RTPS 2.5 §8.2.4, §9.3.1).
#ifndef RIPS_SERVICES_ROS2_GUID_H_
#define RIPS_SERVICES_ROS2_GUID_H_

#include <array>
#include <compare>
#include <cstdint>
#include <string>
#include <utility>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::ros2 {

struct Guid {
  // 12-byte participant prefix, then 4-byte entity id, in wire order.
  std::array<uint8_t, 16> bytes{};

  friend auto operator<=>(const Guid&, const Guid&) = default;
  template <typename H>
  friend H AbslHashValue(H h, const Guid& guid) {
    return H::combine_contiguous(std::move(h), guid.bytes.data(), guid.bytes.size());
  }

  bool none() const { return *this == Guid{}; }
  // Same participant.
  bool SamePrefix(const Guid& other) const;
  // The participant that owns this endpoint: same prefix, entity id 000001c1.
  Guid Participant() const;
  // 16 bytes as on the wire of rips.v1.
  std::string ToBytes() const;
};

// "01104a3b.00000000.00000000.000003c1"
std::string ToString(const Guid& guid);

// Inverse of ToString. InvalidArgument for anything else.
absl::StatusOr<Guid> ParseGuid(absl::string_view text);

// InvalidArgument unless `bytes` is 16 bytes long.
absl::StatusOr<Guid> GuidFromBytes(absl::string_view bytes);

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_GUID_H_
