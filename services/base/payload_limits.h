// How much of a message's payload travels from a sensor to the policy server, and in what pieces.
#ifndef RIPS_SERVICES_BASE_PAYLOAD_LIMITS_H_
#define RIPS_SERVICES_BASE_PAYLOAD_LIMITS_H_

#include <cstddef>
#include <cstdint>

namespace rips {

// Bytes of one payload, CDR header included: unless the bundle's manifest says otherwise, and
// whatever it says. Of a longer payload the first bytes travel.
inline constexpr uint32_t kPayloadBytesDefault = uint32_t{1} << 20;
inline constexpr uint32_t kPayloadBytesHard = uint32_t{4} << 20;
// The least a manifest may say.
inline constexpr uint32_t kPayloadBytesLeast = 1024;
// A longer payload travels as PayloadChunks of this size; the last may be shorter.
inline constexpr size_t kPayloadChunkBytes = size_t{64} << 10;
// Patterns of topics with a limit of their own.
inline constexpr size_t kPayloadLimitsMax = 64;

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_PAYLOAD_LIMITS_H_
