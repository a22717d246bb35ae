// Batches of observations that are not live any more: set aside while the server was away or slow,
// or left by former processes. In memory first, on disk when there is much of it, and read back in
// order when it can be sent.
//
// Everything in it has a number. What this process sets aside counts in an incarnation of its own,
// so that live observations, which count in that of the process, need not wait for it: the server
// wants the observations of one incarnation and lane in order.
//
// | what cannot be read back                        | is told as                                  |
// |-------------------------------------------------|---------------------------------------------|
// | control observations before others of theirs    | a Loss SPOOL_LOST of one under each number: |
// |                                                 | that lane must have no gap                  |
// | messages before others of theirs                | the gap in the numbers, which the server    |
// |                                                 | counts                                      |
// | the last ones of a stream, if a seal names them | one Loss SPOOL_LOST with their count        |
// | an unknown number                               | one Loss SPOOL_LOST with count 1            |
//
// A disk that refuses (full, broken) is asked again; meanwhile what does not fit into memory stays
// with the caller, who sheds it by his rules.
#ifndef RIPS_SENSOR_AGENT_SPOOL_BACKLOG_H_
#define RIPS_SENSOR_AGENT_SPOOL_BACKLOG_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "sensor_agent/outbox/observation.h"
#include "sensor_agent/spool/spool.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

struct BacklogOptions {
  // What is neither written nor underway. Beyond half of it, the oldest is written to disk.
  size_t memory_bytes = size_t{32} << 20;
  // Empty dir or no disk_bytes: nothing is kept on disk.
  SpoolOptions spool = {.disk_bytes = 0};
  // What is read from disk before it can be sent.
  size_t read_ahead_bytes = size_t{1} << 20;
  absl::Duration retry = absl::Seconds(5);
};

// What may be sent next.
struct BacklogBatch {
  StreamKey stream;
  uint64_t first_sequence = 1;
  uint32_t count = 0;
  // To be added to the times inside.
  int64_t time_shift_ns = 0;
  // As they were put. Null: these control observations are lost.
  std::shared_ptr<const std::string> bytes;
};

struct BacklogRange {
  StreamKey stream;
  uint64_t first_sequence = 1;
  uint64_t last_sequence = 0;

  friend bool operator==(const BacklogRange&, const BacklogRange&) = default;
};

struct BacklogState {
  size_t memory_bytes = 0;
  uint64_t disk_bytes = 0;
  // Observations that have not been acknowledged, lost control observations included.
  uint64_t observations = 0;
  // There is no disk although there should be, or it does not take what should be written.
  bool disk_refuses = false;
  // Numbered observations that could not be read back, since the start.
  uint64_t unreadable = 0;
  // The end of a stream could not be read back after Rewind had given it: who was told of it waits
  // in vain until there is a new connection.
  bool announced_too_much = false;
  // CLOCK_BOOTTIME of the oldest observation.
  std::optional<int64_t> oldest_ns;
};

// Any thread; one thread of its own, which alone waits for the disk.
class Backlog {
 public:
  // `incarnation`: 16 bytes, of what is set aside from now on. `wake` is called without locks held
  // when there is something new to send, or room again. `clock` is not owned and outlives this.
  Backlog(BacklogOptions options, std::string incarnation, const Clock* clock,
          std::function<void()> wake);
  ~Backlog();

  // Takes the directory. FailedPrecondition: another process has it. Any other trouble is logged,
  // and memory must do.
  absl::Status Open();
  // Reads what former processes left. Once.
  void Start();
  // Writes what is not yet on disk, and ends the thread. How many observations found no place.
  uint64_t Stop() ABSL_LOCKS_EXCLUDED(mu_);
  // Until Start has read everything: only then Rewind knows all ranges.
  void WaitUntilRecovered() ABSL_LOCKS_EXCLUDED(mu_);
  // There is a place on disk.
  bool on_disk() const { return has_disk_; }

  // --- Filling
  // False: the caller keeps what he has.
  bool HasRoom() const ABSL_LOCKS_EXCLUDED(mu_);
  // Room is scarce: what comes should leave its payloads behind.
  bool ShouldShedPayloads() const ABSL_LOCKS_EXCLUDED(mu_);
  // `count` observations (1 to kFrameObservationsMax, kFrameBytesMax bytes) under the next numbers
  // of this process's backlog.
  void SetAside(Lane lane, uint32_t count, int64_t oldest_ns, std::string bytes)
      ABSL_LOCKS_EXCLUDED(mu_);
  // Under the numbers they have; they follow what was put of the stream before.
  void Put(const StreamKey& stream, uint64_t first_sequence, uint32_t count, int64_t oldest_ns,
           std::string bytes) ABSL_LOCKS_EXCLUDED(mu_);

  // --- Sending
  // A new connection: everything is unsent again. What to announce; none of it is sent before its
  // first acknowledgement.
  std::vector<BacklogRange> Rewind() ABSL_LOCKS_EXCLUDED(mu_);
  // The oldest unsent batch of the lane, if it is in memory; otherwise `wake` is called later.
  std::optional<BacklogBatch> Front(Lane lane) const ABSL_LOCKS_EXCLUDED(mu_);
  // Front(stream.lane) has gone out.
  void MarkSent(const StreamKey& stream) ABSL_LOCKS_EXCLUDED(mu_);
  // Forgets batches up to and including `sequence`. InvalidArgument if that was never sent, and
  // this is not the first acknowledgement of the connection.
  absl::Status Acknowledge(const StreamKey& stream, uint64_t sequence) ABSL_LOCKS_EXCLUDED(mu_);

  // That batch of Front makes no sense: it is lost.
  void Discard(const StreamKey& stream, uint64_t first_sequence, const absl::Status& why)
      ABSL_LOCKS_EXCLUDED(mu_);

  // The server ended the connection because of what it was told. If that happens twice with
  // batches underway and none acknowledged in between, the oldest of them are lost: otherwise they
  // would be refused for ever.
  void Refused(const absl::Status& why) ABSL_LOCKS_EXCLUDED(mu_);

  // --- Looking
  // Lost observations that no number tells of, since the last call.
  std::vector<Loss> TakeLosses() ABSL_LOCKS_EXCLUDED(mu_);
  BacklogState state() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Entry {
    uint64_t first_sequence = 1;
    uint32_t count = 0;
    int64_t oldest_ns = 0;
    std::shared_ptr<const std::string> bytes;
    std::optional<SpoolRecord> record;
    // Control observations that are lost.
    bool gap = false;

    uint64_t last_sequence() const { return first_sequence + count - 1; }
    // Or nothing to write.
    bool on_disk() const { return record.has_value() || gap; }
  };
  struct Queue {
    StreamKey stream;
    std::deque<Entry> entries;
    uint64_t next_sequence = 1;
    // Of the newest entry that was acknowledged.
    uint64_t acknowledged = 0;
    // Leading entries that have gone out, and that are on disk or gaps.
    size_t sent = 0;
    size_t written = 0;
    uint64_t highest_sent = 0;
    bool resumed = true;
  };
  // Names an entry while the lock is not held.
  struct Place {
    StreamKey stream;
    uint64_t first_sequence = 1;
  };

  Queue& QueueOf(const StreamKey& stream) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Queue* FindQueue(const StreamKey& stream) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  Entry* Find(const Place& place) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  const Queue* FrontQueue(Lane lane) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void PutLocked(Queue& queue, Entry entry) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void SetBytes(Entry& entry, std::shared_ptr<const std::string> bytes)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  static void AdvanceWritten(Queue& queue);
  void PopFront(Queue& queue) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  uint64_t UnwrittenLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void DiscardLocked(const StreamKey& stream, uint64_t first_sequence, const absl::Status& why)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void AddLoss(uint64_t count) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void AddGap(Queue& queue, uint64_t first_sequence, uint64_t count)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  // --- The thread's
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  void Recover() ABSL_LOCKS_EXCLUDED(mu_);
  std::optional<Place> NextToWrite() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  std::optional<Place> NextToRead() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Each gives up the lock while it waits for the disk.
  void WriteOne(const Place& place) ABSL_LOCKS_EXCLUDED(mu_);
  void ReadOne(const Place& place) ABSL_LOCKS_EXCLUDED(mu_);
  void TakeRecord(const Place& place, const SpoolRecord& record) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const BacklogOptions options_;
  const std::string incarnation_;
  const Clock* clock_;
  const std::function<void()> wake_;

  // The thread's, once that runs; null = memory only.
  std::unique_ptr<Spool> spool_;
  // Set by Open.
  bool has_disk_ = false;
  std::thread thread_;

  mutable Mutex mu_;
  CondVar work_;
  CondVar recovered_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  bool recovered_ ABSL_GUARDED_BY(mu_) = false;
  // In the order in which they are sent: former incarnations first.
  std::deque<Queue> queues_ ABSL_GUARDED_BY(mu_);
  // Of bytes held that are not on disk, and of all that are held.
  size_t unwritten_bytes_ ABSL_GUARDED_BY(mu_) = 0;
  size_t memory_bytes_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t disk_bytes_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t unreadable_ ABSL_GUARDED_BY(mu_) = 0;
  bool announced_too_much_ ABSL_GUARDED_BY(mu_) = false;
  // Connections refused in a row with batches underway.
  int refusals_ ABSL_GUARDED_BY(mu_) = 0;
  // The disk is not asked before; 0 = it takes what it is given.
  int64_t refuses_until_ns_ ABSL_GUARDED_BY(mu_) = 0;
  std::vector<SpoolRecord> to_release_ ABSL_GUARDED_BY(mu_);
  std::vector<Loss> losses_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_SPOOL_BACKLOG_H_
