// The batches of one stream in the backlog: in memory, on disk, or both; sent again after a new
// connection until they are acknowledged.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_BACKLOG_QUEUE_H_
#define RIPS_SENSOR_AGENT_OUTBOX_BACKLOG_QUEUE_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "sensor_agent/outbox/spool_types.h"

namespace rips::sensor {

struct BacklogEntry {
  uint64_t first_sequence = 1;
  uint32_t count = 0;
  int64_t oldest_ns = 0;
  // Null: on disk only, or a gap.
  std::shared_ptr<const std::string> bytes;
  std::optional<SpoolRecord> record;
  // Control observations that are lost.
  bool gap = false;

  uint64_t last_sequence() const { return first_sequence + count - 1; }
  // Or nothing to write.
  bool on_disk() const { return record.has_value() || gap; }
};

// Not thread-safe.
class BacklogQueue {
 public:
  explicit BacklogQueue(StreamKey stream) : stream_(std::move(stream)) {}

  const StreamKey& stream() const { return stream_; }
  const std::deque<BacklogEntry>& entries() const { return entries_; }
  uint64_t next_sequence() const { return next_sequence_; }
  // Of bytes held, and of those held that are not on disk.
  size_t memory_bytes() const { return memory_bytes_; }
  size_t unwritten_bytes() const { return unwritten_bytes_; }

  // Follows what was put before.
  void Put(BacklogEntry entry);

  // A new connection: everything is unsent, and nothing is sent before an acknowledgement. True if
  // there is something to announce.
  bool Rewind();
  // The oldest unsent entry; null if there is none, or its acknowledgement is still to come.
  const BacklogEntry* Front() const;
  // Front() has gone out.
  void MarkSent();
  size_t sent() const { return sent_; }
  // Forgets entries up to and including `sequence`; records of theirs are added to `release`. True
  // if one went. They need not have been sent on this connection: the server may come to what an
  // earlier one brought, live or by a process before, while this one is made.
  bool Acknowledge(uint64_t sequence, std::vector<SpoolRecord>& release);

  // The oldest entry that is not on disk; null = none.
  const BacklogEntry* NextToWrite() const;
  // The oldest entry among the first unsent `ahead_bytes` that is on disk only; null = none.
  const BacklogEntry* NextToRead(size_t ahead_bytes) const;
  // The entry that was written now has this record. False: there is no such entry any more.
  bool Written(uint64_t first_sequence, const SpoolRecord& record);
  // The entry that was read has these bytes, if it is still there.
  void ReadBack(uint64_t first_sequence, std::string bytes);

  // The entry's bytes are lost. Of control observations it becomes a gap; messages go. `released`
  // is its record, `untold` the number of observations that no later number shows as missing.
  struct Discarded {
    uint32_t count = 0;
    std::optional<SpoolRecord> released;
    uint64_t untold = 0;
  };
  // nullopt: there is no such entry.
  std::optional<Discarded> Discard(uint64_t first_sequence);

 private:
  BacklogEntry* Find(uint64_t first_sequence);
  void SetBytes(BacklogEntry& entry, std::shared_ptr<const std::string> bytes);
  void AdvanceWritten();
  void PopFront(std::vector<SpoolRecord>& release);

  StreamKey stream_;
  std::deque<BacklogEntry> entries_;
  uint64_t next_sequence_ = 1;
  // Of the newest entry that was acknowledged.
  uint64_t acknowledged_ = 0;
  // Leading entries that have gone out, and that are on disk or gaps.
  size_t sent_ = 0;
  size_t written_ = 0;
  bool resumed_ = true;
  size_t memory_bytes_ = 0;
  size_t unwritten_bytes_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_BACKLOG_QUEUE_H_
