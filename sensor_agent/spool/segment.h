// One segment file of the spool, as bytes (FORMAT.md). A segment holds frames of one stream of
// observations, in order. Whatever the bytes are, reading them ends, and gives only frames whose
// checksums are right.
#ifndef RIPS_SENSOR_AGENT_SPOOL_SEGMENT_H_
#define RIPS_SENSOR_AGENT_SPOOL_SEGMENT_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "sensor_agent/outbox/spool_types.h"

namespace rips::sensor {

inline constexpr size_t kBootIdBytes = 16;
inline constexpr size_t kSegmentHeaderBytes = 76;
inline constexpr size_t kFrameHeaderBytes = 36;
// Of one frame without its header. A batch has one payload of 4 MiB at most, and names.
inline constexpr size_t kFrameBytesMax = size_t{8} << 20;
// Observations in one frame, as in one batch.
inline constexpr uint32_t kFrameObservationsMax = 256;
inline constexpr uint64_t kSequenceMax = uint64_t{1} << 62;

struct SegmentHeader {
  StreamKey stream;
  // Counts the segments of a spool: their order.
  uint64_t index = 0;
  // Of the first frame.
  uint64_t first_sequence = 1;
  // To tell times of one boot from those of another, and to convert them.
  std::string boot_id;  // 16 bytes
  int64_t unix_minus_boottime_ns = 0;

  friend bool operator==(const SegmentHeader&, const SegmentHeader&) = default;
};

// CRC-32C (Castagnoli: polynomial 1EDC6F41 reflected, RFC 3720 §B.4) of what `crc` covers, then
// `bytes`; that of nothing is 0.
uint32_t Crc32c(uint32_t crc, absl::string_view bytes);

std::string EncodeSegmentHeader(const SegmentHeader& header);
// DataLoss if it is cut, of another version or damaged.
absl::StatusOr<SegmentHeader> DecodeSegmentHeader(absl::string_view bytes);

// The file's name says what the header says of stream, index and first sequence, so that a segment
// with a damaged header can be read, and a lost one counted.
std::string SegmentName(const SegmentHeader& header);
// nullopt if it is no such name. boot_id is empty.
std::optional<SegmentHeader> ParseSegmentName(absl::string_view name);

// Observations [first_sequence, first_sequence + count). No observations: the seal, which says that
// the stream continued, if at all, in another segment and with first_sequence.
struct Frame {
  uint64_t first_sequence = 1;
  uint32_t count = 0;
  // CLOCK_BOOTTIME of the oldest observation in it.
  int64_t oldest_ns = 0;
  // A view into what was scanned.
  absl::string_view payload;
  // Of the frame's header, from the start of the file.
  size_t offset = 0;
};

// Checksums of frames begin with this, so that frames of another segment, or a robot's payload that
// looks like one, do not pass for frames of this one.
uint32_t FrameSeed(const SegmentHeader& header);

// At most kFrameObservationsMax observations and kFrameBytesMax bytes.
void AppendFrame(uint32_t seed, const Frame& frame, std::string* out);

// One frame that should begin at the start of `bytes`; `offset` is left 0. DataLoss.
absl::StatusOr<Frame> DecodeFrame(uint32_t seed, absl::string_view bytes);

class FrameScanner {
 public:
  // `file` is the whole segment, its header included, and outlives this and the frames.
  FrameScanner(uint32_t seed, absl::string_view file);

  // The next intact frame; what lies between is skipped. nullopt at the end.
  std::optional<Frame> Next();
  // Bytes that belong to no intact frame, so far.
  size_t skipped() const { return skipped_; }

 private:
  const uint32_t seed_;
  const absl::string_view file_;
  size_t at_;
  size_t skipped_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_SPOOL_SEGMENT_H_
