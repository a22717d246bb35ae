// MCAP recordings (mcap.dev, format version 0), from front to back; the summary is not needed.
//
// Messages come in the order of the file; those of one chunk by log time, then order. Their time is
// the log time. Writers give chunks in order of time; if they overlap, times go back at the seam.
// Records of kinds that are not known are skipped.
//
// Every checksum that is there (not 0) is checked: of a chunk before anything of it is given, of
// the data section at its end. That one covers, by writer, the file from its first byte or from the
// end of the header: both are accepted.
//
// Memory: one chunk as stored and as decompressed, each at most kChunkBytesMax, and 16 bytes a
// message of it. A file without footer was cut, or is still being written: it gives all whole
// chunks, the whole messages of the chunk that the end cuts (its checksum cannot be checked), then
// DataLoss. After a chunk that is damaged nothing is given.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_MCAP_READER_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_MCAP_READER_H_

#include <cstddef>
#include <memory>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/recording/input_file.h"
#include "policy_server/policy/recording/reader.h"

namespace rips::recording {

inline constexpr absl::string_view kMcapMagic("\x89MCAP0\r\n", 8);

// Inclusive; of the stored and of the decompressed chunk, bytes.
inline constexpr size_t kChunkBytesMax = size_t{256} << 20;
// Largest schema or channel, bytes: a message definition with everything it includes. Inclusive.
inline constexpr size_t kDefinitionBytesMax = size_t{4} << 20;

// `file` stands at its first byte. The message encoding of every channel must be `cdr`; the name of
// its schema is the type of its messages.
absl::StatusOr<std::unique_ptr<Reader>> OpenMcap(std::unique_ptr<InputFile> file);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_MCAP_READER_H_
