// Batches of observations that are not live any more: set aside while the server was away or slow,
// or left by former processes. In memory first, on disk when there is much of it, and read back in
// order when it can be sent.
//
// Everything in it has a number. What this process sets aside counts in an incarnation of its own,
// so that live observations, which count in that of the process, need not wait for it: the server
// wants the observations of one incarnation and lane in order.
//
// | what cannot be read back                        | is reported as                              |
// |-------------------------------------------------|---------------------------------------------|
// | control observations before others of theirs    | a Loss SPOOL_LOST of one under each number: |
// |                                                 | that lane must have no gap                  |
// | messages before others of theirs                | the gap in the numbers, which the server    |
// |                                                 | counts                                      |
// | the last ones of a stream, if a seal names them | one Loss SPOOL_LOST with their count        |
// | an unknown number                               | one Loss SPOOL_LOST with count 1            |
//
// A disk that refuses (full, broken) is asked again; meanwhile what does not fit into memory stays
// with the outbox, which sheds it by its own rules.
//
// Pure: the disk's work leaves as jobs, one write and one read at a time, and comes back as their
// results.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_BACKLOG_H_
#define RIPS_SENSOR_AGENT_OUTBOX_BACKLOG_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "sensor_agent/outbox/backlog_queue.h"
#include "sensor_agent/outbox/spool_types.h"

namespace rips::sensor {

struct BacklogOptions {
  // What is neither written nor underway. Beyond half of it, the oldest is written to disk.
  size_t memory_bytes = size_t{32} << 20;
  // What is read from disk before it can be sent.
  size_t read_ahead_bytes = size_t{1} << 20;
  // A disk that refused is asked again after this time.
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

// What a batch of the backlog takes at most on the wire: with the numbers of a stream it grows by
// three ids of an observation, by two bytes each, and by what is written only then.
inline uint64_t BacklogBytesMax(uint64_t bytes, uint32_t count) {
  return bytes + 8 * uint64_t{count} + 64;
}

struct BacklogRange {
  StreamKey stream;
  uint64_t first_sequence = 1;
  uint64_t last_sequence = 0;

  friend bool operator==(const BacklogRange&, const BacklogRange&) = default;
};

struct BacklogState {
  size_t memory_bytes = 0;
  // Observations that have not been acknowledged, lost control observations included.
  uint64_t observations = 0;
  // There is no disk although there should be, or it does not take what should be written.
  bool disk_refuses = false;
  // Numbered observations that could not be read back, since the start.
  uint64_t unreadable = 0;
  // The end of a stream could not be read back after Rewind had announced it: the server waits for
  // it in vain until there is a new connection.
  bool announced_too_much = false;
  // CLOCK_BOOTTIME of the oldest observation.
  std::optional<int64_t> oldest_ns;
};

// Not thread-safe. Times are CLOCK_BOOTTIME in nanoseconds.
class Backlog {
 public:
  // `incarnation`: 16 bytes, of what is set aside from now on. There is no disk until SetDisk.
  Backlog(BacklogOptions options, std::string incarnation);

  // --- Filling
  // False: the outbox keeps what it has.
  bool HasRoom() const { return UnwrittenBytes() < options_.memory_bytes; }
  // Room is scarce, in memory or with `disk_bytes` on disk: what comes should leave its payloads
  // behind.
  bool ShouldShedPayloads() const;
  // The number that the next observation set aside gets.
  StreamKey Own(Lane lane) const { return {.incarnation = incarnation_, .lane = lane}; }
  uint64_t NextSequence(const StreamKey& stream) const;
  // `count` observations (1 to 256, 8 MiB at most), which follow what was put of the stream before.
  void Put(const StreamKey& stream, uint64_t first_sequence, uint32_t count, int64_t oldest_ns,
           std::string bytes);

  // --- Sending
  // A new connection: everything is unsent again. What to announce; none of it is sent before its
  // first acknowledgement.
  std::vector<BacklogRange> Rewind();
  // Of the lane, whether it may be sent already or not.
  bool HasUnsent(Lane lane) const;
  // The oldest unsent batch of the lane, if it is in memory; nullopt until it was read otherwise.
  std::optional<BacklogBatch> Front(Lane lane) const;
  // Front(stream.lane) has gone out.
  void MarkSent(const StreamKey& stream);
  // Forgets batches up to and including `sequence`, as BacklogQueue does. InvalidArgument if this
  // process has given no such number.
  absl::Status Acknowledge(const StreamKey& stream, uint64_t sequence);
  // That batch cannot be decoded or read: it is lost.
  void Discard(const StreamKey& stream, uint64_t first_sequence, int64_t now_ns);
  // The server ended the connection because of what it received. If that happens twice with batches
  // underway and none acknowledged in between, the oldest of them are discarded: otherwise they
  // would be refused for ever. Gives these, with their first sequence.
  std::vector<std::pair<StreamKey, uint64_t>> OnRefused(int64_t now_ns);

  // --- The disk
  // It holds `bytes` of at most `bytes_max`. bytes_max 0 = there is no disk; it `refuses` if there
  // should be one.
  struct Disk {
    uint64_t bytes_max = 0;
    bool refuses = false;
    uint64_t bytes = 0;
  };
  void SetDisk(const Disk& disk) { disk_ = disk; }
  // What former processes left; once, before anything is put.
  void Recover(const Recovered& recovered, int64_t now_ns);
  // Everything is to be written from now on; a disk that refused is asked once more.
  void BeginStop();
  // The next job. Releases come at once; a write and a read are underway until their result comes.
  std::optional<SpoolJob> NextJob(int64_t now_ns);
  void On(const SpoolReleased& result) { disk_.bytes = result.disk_bytes; }
  void On(SpoolWritten result, int64_t now_ns);
  // The first sequence of what is lost, because it cannot be read.
  std::optional<uint64_t> On(SpoolReadBack result, int64_t now_ns);
  bool writing() const { return writing_; }
  // When a disk that refused is asked again; nullopt = it takes what it is given, or is not needed.
  std::optional<int64_t> RetryAt() const;

  // --- State
  // Lost observations that no number shows, since the last call.
  std::vector<Loss> PopLosses() { return std::exchange(losses_, {}); }
  BacklogState state() const;
  // Observations that are not on disk.
  uint64_t Unwritten() const;
  const Disk& disk() const { return disk_; }

 private:
  BacklogQueue* Find(const StreamKey& stream);
  BacklogQueue& QueueOf(const StreamKey& stream);
  const BacklogQueue* FrontQueue(Lane lane) const;
  size_t UnwrittenBytes() const;
  void AddLoss(uint64_t count, int64_t now_ns);
  void AddGap(const SpoolGap& gap, int64_t now_ns);
  std::optional<SpoolJob> NextWrite(int64_t now_ns);
  std::optional<SpoolJob> NextRead();

  const BacklogOptions options_;
  const std::string incarnation_;
  Disk disk_;
  // In the order in which they are sent: former incarnations first.
  std::deque<BacklogQueue> queues_;
  uint64_t unreadable_ = 0;
  bool announced_too_much_ = false;
  // Connections refused in a row with batches underway.
  int refusals_ = 0;
  // The disk is not asked before; 0 = it takes what it is given.
  int64_t refuses_until_ns_ = 0;
  bool stopping_ = false;
  bool writing_ = false;
  bool reading_ = false;
  std::vector<SpoolRecord> to_release_;
  std::vector<Loss> losses_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_BACKLOG_H_
