// Recordings in our own format (FORMAT.md). Events come in the order they were written; their times
// are as recorded. Memory: one frame, at most kFrameBytesMax, and what it decodes to.
//
// A recording that was cut, as by a crash, gives every whole frame, then DataLoss that names the
// offset of the torn one.
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_RIPS_READER_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_RIPS_READER_H_

#include <memory>

#include "absl/status/statusor.h"
#include "policy_server/policy/recording/input_file.h"
#include "policy_server/policy/recording/reader.h"

namespace rips::recording {

// `file` stands at its first byte. The origin is read here.
absl::StatusOr<std::unique_ptr<Reader>> OpenRips(std::unique_ptr<InputFile> file);

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_RIPS_READER_H_
