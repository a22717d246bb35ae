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
// | directed_data  | a writer that we read goes on writing, and nothing of it reaches our reader|
//
// A finding stands as long as its evidence does: until discovery shows the writer, until data
// reaches us again, or until nothing more of it was on the wire for forget_ns.
#ifndef RIPS_SENSOR_AGENT_WIRE_WIRE_WATCH_H_
#define RIPS_SENSOR_AGENT_WIRE_WIRE_WATCH_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/flat_hash_map.h"
#include "absl/types/span.h"
#include "sensor_agent/outbox/observation.h"
#include "sensor_agent/wire/traffic.h"
#include "services/ros2/guid.h"

namespace rips::wire {

struct WatchOptions {
  uint32_t domain = 0;
  // How long something may be on the wire before discovery shows it.
  int64_t grace_ns = 2'000'000'000;
  // The same for a participant that announces itself by multicast: it does not hide, and if the
  // first announcement was lost the next one comes after 8 s (Cyclone) or 3 s (Fast DDS).
  int64_t announced_grace_ns = 10'000'000'000;
  // Known participants and writers that have gone stay known: datagrams are reported later.
  int64_t tombstone_ns = 10'000'000'000;
  int64_t forget_ns = 60'000'000'000;
  // directed_data: so many samples on the wire in so long a time without one for our reader.
  uint64_t bypass_samples = 10;
  int64_t bypass_ns = 5'000'000'000;
  int64_t judge_interval_ns = 200'000'000;
  // As discovery shows them. Beyond, unicast_writer cannot be judged and is not.
  size_t known_participants = 4'096;
  size_t known_writers = 32'768;
  // On the wire; what is of more participants is not judged.
  size_t participants = 4'096;
  // Of one participant: its unknown writers, and where it sends from. More are not told apart.
  size_t writers_each = 64;
  size_t sources_each = 32;
  // Findings that stand at a time.
  size_t findings = 256;
};

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

  // Discovery is told anew from the start: what is not seen again counts as gone now.
  void Rediscover(int64_t now_ns);

  // --- The tap
  void Take(const TapReport& report, int64_t now_ns);
  // The tap is another process now: its counts begin anew.
  void TapChanged();

  // What is over and then what begins to stand. Nothing begins until discovery has `settled`.
  // `received` gives the highest sequence number that our reader has of a writer, 0 = none.
  using Received = std::function<uint64_t(const ros2::Guid&)>;
  std::vector<sensor::Finding> Poll(bool settled, const Received& received, int64_t now_ns);

  // Findings that stand, by kind and GUID.
  using FindingKey = std::pair<std::string, ros2::Guid>;
  using Findings = absl::btree_map<FindingKey, sensor::Finding>;
  const Findings& standing() const { return standing_; }
  // Further ones are dropped.
  bool full() const { return standing_.size() >= options_.findings; }
  const WatchCounters& counters() const { return counters_; }
  // A limit on what discovery shows was hit.
  bool blind() const { return blind_; }

 private:
  struct KnownParticipant {
    std::vector<Locator> advertised;
    int64_t gone_ns = 0;  // 0 = there
  };
  struct KnownWriter {
    std::string topic;
    int64_t gone_ns = 0;
    bool read = false;
    // Highest sequence number on the wire.
    uint64_t on_wire = 0;
    // When our reader last got on, how far it was, and how far the wire was then.
    int64_t progress_ns = 0;
    uint64_t received = 0;
    uint64_t on_wire_then = 0;
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
  };

  bool IsOurs(const Traffic& traffic) const;
  bool Knows(const ros2::Guid& participant) const;
  bool Local(const Address& address) const;
  bool MaySendFrom(const ros2::Guid& participant, const Participant& seen,
                   const Address& address) const;
  std::string TopicOf(const ros2::Guid& writer) const;

  void TakeSource(const Traffic& traffic, int64_t now_ns, Participant& seen);
  void TakeSuspect(const Traffic& traffic, int64_t now_ns, Suspect& suspect) const;
  void Forget(int64_t now_ns);

  void JudgeUnknown(const ros2::Guid& guid, const Participant& seen, int64_t now_ns,
                    Findings& found) const;
  void JudgeSources(const ros2::Guid& guid, const Participant& seen, int64_t now_ns,
                    Findings& found) const;
  void JudgeBypass(const Received& received, int64_t now_ns, Findings& found);
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
  int64_t settled_ns_ = 0;  // 0 = not yet
  int64_t next_judgement_ns_ = 0;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_WIRE_WATCH_H_
