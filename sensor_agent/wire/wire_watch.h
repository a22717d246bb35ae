// Judges what the tap saw by what discovery shows: writers that discovery never showed,
// participants that speak from places where they are not, data that goes past our readers.
//
// | finding        | when                                                                       |
// |----------------|----------------------------------------------------------------------------|
// | unicast_writer | a writer, or a participant that only announces itself or acknowledges, is  |
// |                | on the wire of this domain and unknown to discovery past the grace         |
// | spoofed_writer | datagrams of a known participant come from an address that it does not     |
// |                | advertise, or by turns from more ports of one address than its middleware  |
// |                | uses                                                                       |
// | directed_data  | a writer that we read sends samples, and less than half of them reach our  |
// |                | reader (reception.h)                                                       |
// | two_contents   | a sample of a user's writer was on the wire with two contents              |
//
// A finding stands as long as its evidence does: `unicast_writer` until discovery shows the writer
// or nothing more of it was on the wire for forget_ns, `directed_data` until data reaches us again.
// What forged datagrams do to a reader lasts as long as the writer: `spoofed_writer` and
// `two_contents` stand until discovery says that the writer or its participant has gone.
//
// Numbers that one writer cannot have (writer_numbers.h) are handed out as jumps: `sequence_jump`
// is a finding of the readers.
#ifndef RIPS_SENSOR_AGENT_WIRE_WIRE_WATCH_H_
#define RIPS_SENSOR_AGENT_WIRE_WIRE_WATCH_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/flat_hash_map.h"
#include "absl/types/span.h"
#include "sensor_agent/outbox/observation.h"
#include "sensor_agent/wire/reception.h"
#include "sensor_agent/wire/traffic.h"
#include "sensor_agent/wire/watch_options.h"
#include "sensor_agent/wire/writer_numbers.h"
#include "services/ros2/guid.h"

namespace rips::wire {

struct WatchCounters {
  // Reports about datagrams of other domains.
  uint64_t foreign = 0;
  // What was left out because of a limit on what is on the wire.
  uint64_t dropped = 0;
  // Findings left out because too many stand.
  uint64_t findings_dropped = 0;
};

// On the wire, and unknown to discovery so far.
struct Suspect {
  int64_t first_ns = 0;
  int64_t last_ns = 0;
  uint64_t packets = 0;
  Locator from;
  Locator to;
};

// Numbers that one writer cannot have.
struct Jump {
  ros2::Guid writer;
  // Human-readable.
  std::string detail;
};

// A sample was on the wire with two contents, of which our reader has one.
struct SecondContent {
  ros2::Guid writer;
  uint64_t number = 0;
  uint32_t size = 0;  // bytes
};

// Not thread-safe; no clock: times are CLOCK_BOOTTIME in nanoseconds and never go back.
class WireWatch {
 public:
  explicit WireWatch(WatchOptions options) : options_(options) {}
  // The kinds that it tells, as Finding::kind.
  static absl::Span<const char* const> Kinds();

  // --- Discovery. `advertised`: locators the participant is reached at; empty = not known.
  void ParticipantSeen(const ros2::Guid& participant, const std::vector<Locator>& advertised);
  void ParticipantGone(const ros2::Guid& participant, int64_t now_ns);
  // `topic` is what a finding about it names.
  void WriterSeen(const ros2::Guid& writer, const std::string& topic);
  void WriterGone(const ros2::Guid& writer, int64_t now_ns);
  // We have a reader for this writer, which WriterSeen told of.
  void WriterRead(const ros2::Guid& writer, int64_t now_ns);
  // Of every writer, whether we have a reader for it.
  void SetReaders(const std::function<bool(const ros2::Guid&)>& reads, int64_t now_ns);

  // Our reader got this sample, or lost samples of any writer after it got them.
  void Received(const ros2::Guid& writer, uint64_t number);
  void ReceivedAndLost();

  // Discovery is told anew from the start: what is not seen again counts as gone now.
  void Rediscover(int64_t now_ns);

  // --- The tap
  void Take(const TapReport& report, int64_t now_ns);
  // The tap is another process now: its counts begin anew.
  void TapChanged();

  // What is over and then what begins to stand. Nothing begins until discovery has `settled`.
  std::vector<sensor::Finding> Poll(bool settled, int64_t now_ns);
  // Since the last call; nothing until discovery has settled. The writer or its participant is
  // known, and may be built in.
  std::vector<Jump> TakeJumps();
  // Of writers that we read, since the last call; one for each report.
  std::vector<SecondContent> TakeSecondContents() { return std::exchange(second_contents_, {}); }

  // Findings that stand, by kind and GUID.
  using FindingKey = std::pair<std::string, ros2::Guid>;
  using Findings = absl::btree_map<FindingKey, sensor::Finding>;
  const Findings& standing() const { return standing_; }
  // Further ones are dropped.
  bool full() const { return standing_.size() >= options_.findings; }
  const WatchCounters& counters() const { return counters_; }
  // `directed_data` or `two_contents` of it stands.
  bool Misses(const ros2::Guid& writer) const;
  // Of some writer.
  bool MissesSome() const;
  // A limit on what discovery shows was hit, since it was told from the start.
  bool blind() const { return blind_; }
  // It was, and there is room again: discovery may be told anew.
  bool CanSeeAgain() const;

 private:
  struct KnownParticipant {
    std::vector<Locator> advertised;
    int64_t gone_ns = 0;  // 0 = there
    bool left = false;    // as discovery says
  };
  struct KnownWriter {
    std::string topic;
    int64_t gone_ns = 0;
    bool left = false;
    WriterNumbers numbers;
    // Null = we do not read it.
    std::unique_ptr<Reception> reception;
  };
  // Where datagrams of a participant come from.
  struct Source {
    Locator from;
    uint16_t vendor = 0;
    int64_t first_ns = 0;
    int64_t last_ns = 0;
    uint64_t first_packet = 0;
    uint64_t last_packet = 0;
    // A user's writer that was named there; else the participant.
    ros2::Guid about;
  };
  // What is on the wire.
  struct Participant {
    int64_t last_ns = 0;
    // Announced itself by multicast.
    bool announced = false;
    // By any of its datagrams, as long as discovery does not show it; no packets = not suspect.
    Suspect whole;
    // Sorted by first datagram.
    std::vector<Source> sources;
    absl::btree_map<ros2::Guid, Suspect> writers;
    // Of writers that are not known, and of those that are built in.
    absl::btree_map<ros2::Guid, WriterNumbers> numbers;
  };
  struct Conflict {
    uint64_t count = 0;
    uint64_t number = 0;
    Locator to;
    int64_t last_ns = 0;
  };

  bool IsOurs(const Traffic& traffic) const;
  bool Knows(const ros2::Guid& participant) const;
  // A writer or participant that is there.
  bool IsThere(const ros2::Guid& guid) const;
  bool Local(const Address& address) const;
  bool MaySendFrom(const ros2::Guid& participant, const Participant& seen,
                   const Address& address) const;
  std::string TopicOf(const ros2::Guid& writer) const;

  void TakeSource(const Traffic& traffic, int64_t now_ns, Participant& seen);
  void TakeSuspect(const Traffic& traffic, int64_t now_ns, Suspect& suspect) const;
  void Bury(const ros2::Guid& guid, int64_t& gone_ns, int64_t now_ns);
  void TakeNumbers(const Traffic& traffic, int64_t now_ns, Participant& seen);
  void TakeConflicts(const Traffic& traffic, int64_t now_ns);
  // Discovery says that it has gone: what was forged under its name has no effect any more.
  void EndForgeries(const ros2::Guid& gone);
  void Forget(int64_t now_ns);

  void JudgeUnknown(const ros2::Guid& guid, const Participant& seen, int64_t now_ns,
                    Findings& found) const;
  void JudgeSources(const ros2::Guid& guid, const Participant& seen, int64_t now_ns,
                    Findings& found) const;
  void JudgeReception(int64_t now_ns, Findings& found);
  void JudgeContents(Findings& found) const;
  std::vector<sensor::Finding> Tell(Findings found);

  const WatchOptions options_;
  WatchCounters counters_;
  bool blind_ = false;
  absl::flat_hash_map<ros2::Guid, KnownParticipant> known_participants_;
  absl::flat_hash_map<ros2::Guid, KnownWriter> known_writers_;
  // How many known participants advertise each.
  absl::flat_hash_map<Locator, int> advertised_;
  std::deque<std::pair<int64_t, ros2::Guid>> graves_;  // by time of going
  std::vector<Address> local_;                         // sorted
  absl::btree_map<ros2::Guid, Participant> participants_;
  Findings standing_;
  // spoofed_writer of known participants. At most options_.findings, as conflicts_.
  Findings forgeries_;
  absl::btree_map<ros2::Guid, Conflict> conflicts_;
  std::vector<Jump> jumps_;
  std::vector<SecondContent> second_contents_;
  int64_t settled_ns_ = 0;  // 0 = not yet
  int64_t next_judgement_ns_ = 0;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_WIRE_WATCH_H_
