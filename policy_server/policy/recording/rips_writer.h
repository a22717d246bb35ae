// Writes recordings in our own format (FORMAT.md).
#ifndef RIPS_POLICY_SERVER_POLICY_RECORDING_RIPS_WRITER_H_
#define RIPS_POLICY_SERVER_POLICY_RECORDING_RIPS_WRITER_H_

#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/policy/recording/recorded.h"

namespace rips::recording {

// Magic and header, and the frame of an event, as a file holds them. Errors as RipsWriter::Append
// says of what is not written.
absl::StatusOr<std::string> EncodeStart(const RecordedOrigin& origin);
absl::StatusOr<std::string> EncodeFrame(const Recorded& event);

// Not thread-safe. Each event is on its way to the file when Append returns (one write a frame, no
// buffer here); syncing and closing are the caller's.
class RipsWriter {
 public:
  // Writes magic and header to `fd`, which is not owned, outlives this, and stands at the start of
  // an empty file. Errors as Append.
  static absl::StatusOr<RipsWriter> Create(int fd, const RecordedOrigin& origin);

  // The index is not kept: it is the place in the file. InvalidArgument, and nothing is written: a
  // text that is not UTF-8, a payload longer than size_bytes or shorter without being truncated, a
  // snapshot or context that takes something away. ResourceExhausted, and nothing is written: more
  // than kMessageBytesMax of payload or kFrameBytesMax in all. Otherwise (Unavailable, or
  // ResourceExhausted if the disk is full) the file may end in a torn frame and every later call
  // gives that error.
  absl::Status Append(const Recorded& event);

 private:
  explicit RipsWriter(int fd) : fd_(fd) {}
  absl::Status Write(absl::string_view bytes);

  int fd_;
  absl::Status broken_;
};

}  // namespace rips::recording

#endif  // RIPS_POLICY_SERVER_POLICY_RECORDING_RIPS_WRITER_H_
