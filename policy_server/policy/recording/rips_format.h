// Numbers of our own recording format; FORMAT.md describes it.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_RIPS_FORMAT_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_RIPS_FORMAT_H_

#include <cstddef>
#include <cstdint>

#include "absl/strings/string_view.h"

namespace rips::recording {

// The last byte but two is the version of the format; the line break shows a file that was copied
// as text.
inline constexpr absl::string_view kRipsMagic("\x89RIPS\x01\r\n", 8);
// Length and CRC-32 of the body, both little endian.
inline constexpr size_t kFrameHeaderBytes = 8;
// Largest body: the largest message, and room for its names. Inclusive.
inline constexpr uint32_t kFrameBytesMax = (uint32_t{64} << 20) + (uint32_t{1} << 20);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_RIPS_FORMAT_H_
