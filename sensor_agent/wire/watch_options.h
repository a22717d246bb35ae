// How WireWatch judges, and how much it holds.
#ifndef RIPS_SENSOR_AGENT_WIRE_WATCH_OPTIONS_H_
#define RIPS_SENSOR_AGENT_WIRE_WATCH_OPTIONS_H_

#include <cstddef>
#include <cstdint>

namespace rips::wire {

// Finding::kind of what a writer keeps from us.
inline constexpr char kDirectedData[] = "directed_data";
inline constexpr char kTwoContents[] = "two_contents";

struct WatchOptions {
  uint32_t domain = 0;
  // We use DDS Security: what participants that do encrypt may differ each time it is sent.
  bool secured = false;
  // How long something may be on the wire before discovery shows it.
  int64_t grace_ns = 2'000'000'000;
  // The same for a participant that announces itself by multicast: it does not hide, and if the
  // first announcement was lost the next one comes after 8 s (Cyclone) or 3 s (Fast DDS).
  int64_t announced_grace_ns = 10'000'000'000;
  // Known participants and writers that have gone stay known: datagrams are reported later.
  int64_t tombstone_ns = 10'000'000'000;
  int64_t forget_ns = 60'000'000'000;
  // How long a writer may take to learn of a new reader of ours.
  int64_t match_ns = 2'500'000'000;
  int64_t judge_interval_ns = 200'000'000;
  // As discovery shows them. Beyond, unicast_writer cannot be judged and is not.
  size_t known_participants = 4'096;
  size_t known_writers = 32'768;
  // On the wire; what is of more participants is not judged.
  size_t participants = 4'096;
  // Of one participant: its unknown writers, and where it sends from. More are not told apart.
  size_t writers_each = 64;
  size_t sources_each = 32;
  // Of one participant: writers that are not known, or built in, whose numbers are looked at.
  size_t numbers_each = 96;
  // Findings that stand at a time.
  size_t findings = 256;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_WATCH_OPTIONS_H_
