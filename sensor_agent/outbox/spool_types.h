// What the outbox and the disk say to each other about batches that are set aside: plain values.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_SPOOL_TYPES_H_
#define RIPS_SENSOR_AGENT_OUTBOX_SPOOL_TYPES_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <variant>
#include <vector>

#include "absl/status/statusor.h"
#include "sensor_agent/outbox/observation.h"

namespace rips::sensor {

inline constexpr size_t kIncarnationBytes = 16;

// Observations that count together: each has its own sequence, from 1.
struct StreamKey {
  std::string incarnation;  // 16 bytes
  Lane lane = Lane::kMessages;

  friend auto operator<=>(const StreamKey&, const StreamKey&) = default;
};

// A batch on disk.
struct SpoolRecord {
  StreamKey stream;
  uint64_t first_sequence = 1;
  uint32_t count = 0;
  // CLOCK_BOOTTIME of this boot; of an observation from before it, 0 or less.
  int64_t oldest_ns = 0;
  // To be added to the times in the payload, to make them times of this boot.
  int64_t time_shift_ns = 0;
  // Where it lies: number of the segment, and bytes.
  uint64_t segment = 0;
  size_t offset = 0;
  size_t bytes = 0;
};

// Sequences that were there and are not readable. They lie before the last record of their stream,
// unless `at_end`.
struct SpoolGap {
  StreamKey stream;
  uint64_t first_sequence = 1;
  uint64_t count = 0;
  bool at_end = false;

  friend bool operator==(const SpoolGap&, const SpoolGap&) = default;
};

// What former processes left.
struct Recovered {
  // In order within each stream.
  std::vector<SpoolRecord> records;
  std::vector<SpoolGap> gaps;
  // More was lost, an unknown number: a segment without its end, or a process that crashed.
  bool unknown_lost = false;
  // Human-readable reasons; one line each problem, at most 20.
  std::vector<std::string> problems;
};

// --- Jobs for the disk, and their results

struct SpoolWrite {
  StreamKey stream;
  uint64_t first_sequence = 1;
  uint32_t count = 0;
  int64_t oldest_ns = 0;
  std::shared_ptr<const std::string> bytes;
};
struct SpoolRead {
  SpoolRecord record;
};
// The record is not needed any more.
struct SpoolRelease {
  SpoolRecord record;
};

// The disk holds `disk_bytes` now.
struct SpoolReleased {
  uint64_t disk_bytes = 0;
};
struct SpoolWritten {
  StreamKey stream;
  uint64_t first_sequence = 1;
  absl::StatusOr<SpoolRecord> record;
  uint64_t disk_bytes = 0;
};
struct SpoolReadBack {
  StreamKey stream;
  uint64_t first_sequence = 1;
  absl::StatusOr<std::string> bytes;
};

using SpoolJob = std::variant<SpoolRelease, SpoolRead, SpoolWrite>;
using SpoolResult = std::variant<SpoolReleased, SpoolReadBack, SpoolWritten>;

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_SPOOL_TYPES_H_
