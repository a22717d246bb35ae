// Compressed chunks. Internal to this folder.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_DECOMPRESS_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_DECOMPRESS_H_

#include <cstddef>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace rips::recording {

// First bytes of a Zstandard frame, which begin no CDR payload.
inline constexpr absl::string_view kZstdMagic("\x28\xb5\x2f\xfd", 4);
// Why a message that begins with them is refused.
inline constexpr char kCompressedMessage[] =
    "is compressed; `ros2 bag convert` writes a bag without compression";

// Replaces `out` by what `bytes` hold, which must be `size` bytes. `format` is "" (as it is), "lz4"
// (frame format) or "zstd". InvalidArgument: another format. DataLoss: damaged, cut, or another
// size; `out` then holds what came out before. Never holds more than `size` bytes, nor allocates
// much more than what really comes out; the decoder's window (at most 256 MiB) comes on top.
absl::Status Decompress(absl::string_view format, absl::string_view bytes, size_t size,
                        std::string* out);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_DECOMPRESS_H_
