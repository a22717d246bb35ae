// Observations on disk: a directory of segment files (FORMAT.md). It knows streams, sequences and
// bytes, not what they mean.
//
// What was appended is handed to the kernel at once and written through when its segment is full,
// so the end of a process loses nothing of it; a power cut may lose the last segment of each
// stream. The file `running` lies there while a process uses the directory: found at start, the
// process before crashed, and what it held in memory is lost.
#ifndef RIPS_SENSOR_AGENT_SPOOL_SPOOL_H_
#define RIPS_SENSOR_AGENT_SPOOL_SPOOL_H_

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "sensor_agent/outbox/spool_types.h"
#include "sensor_agent/spool/segment.h"
#include "services/base/clock.h"
#include "services/runtime/unique_fd.h"

namespace rips::sensor {

// Identifies this boot of the host, 16 bytes; zeros if the kernel does not say.
std::string BootId();

struct SpoolOptions {
  std::string dir;
  // Of all segments. A frame that would go beyond is refused.
  uint64_t disk_bytes = uint64_t{256} << 20;
  // A segment that is longer is closed.
  size_t segment_bytes = size_t{4} << 20;
  // Incarnations of former processes that are kept; the oldest beyond are given up.
  size_t incarnations = 12;
  // Of this boot, 16 bytes, and what both clocks say now.
  std::string boot_id;
  Instant now;
};

// Not thread-safe. Waits for the disk.
class Spool {
 public:
  // Creates the directory (0700) if there is none, and takes its lock. FailedPrecondition: another
  // process has it. Unavailable: it cannot be used, and why.
  static absl::StatusOr<std::unique_ptr<Spool>> Open(SpoolOptions options);
  // Without MarkClean the next process finds `running`.
  ~Spool();

  // What former processes left; once, before the first Append. Reads everything.
  Recovered Recover();

  // `frame.first_sequence` follows what was appended to the stream before. ResourceExhausted: past
  // disk_bytes. Unavailable: it could not be written; what was written of it is taken back.
  absl::StatusOr<SpoolRecord> Append(const StreamKey& stream, const Frame& frame);
  // The payload. DataLoss: damaged by now, or gone.
  absl::StatusOr<std::string> Read(const SpoolRecord& record) const;
  // Not needed any more. A segment goes with its last record.
  void Release(const SpoolRecord& record);

  // Seals all segments, writes them through, and says that this process ended in order.
  absl::Status MarkClean();

  uint64_t bytes() const { return bytes_; }

 private:
  struct Segment {
    SegmentHeader header;
    uint32_t seed = 0;
    size_t bytes = 0;
    // Records not released.
    size_t records = 0;
    int64_t time_shift_ns = 0;
    // Of the process that appends; none if it was closed.
    UniqueFd fd;
    uint64_t next_sequence = 1;
  };

  Spool(SpoolOptions options, UniqueFd lock, bool unclean);

  std::string PathOf(const SegmentHeader& header) const;
  void RecoverSegment(const SegmentHeader& named, Recovered& recovered,
                      std::map<StreamKey, uint64_t>& next);
  void DropOldIncarnations(std::vector<SegmentHeader>& named, Recovered& recovered);
  absl::StatusOr<Segment*> OpenSegment(const StreamKey& stream, uint64_t first_sequence);
  absl::Status Close(Segment& segment, bool seal);
  absl::Status WriteAll(Segment& segment, absl::string_view bytes);
  void Remove(uint64_t index);

  const SpoolOptions options_;
  const UniqueFd lock_;
  // A process before this one did not end in order.
  const bool unclean_;
  std::map<uint64_t, Segment> segments_;
  // Where a stream's next frame goes.
  std::map<StreamKey, uint64_t> open_;
  uint64_t next_index_ = 1;
  uint64_t bytes_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_SPOOL_SPOOL_H_
