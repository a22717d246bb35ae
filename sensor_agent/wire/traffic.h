// What was on the wire in one interval: per writer and source, how much and whereto.
#ifndef RIPS_SENSOR_AGENT_WIRE_TRAFFIC_H_
#define RIPS_SENSOR_AGENT_WIRE_TRAFFIC_H_

#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "sensor_agent/wire/content_table.h"
#include "sensor_agent/wire/locator.h"
#include "sensor_agent/wire/number_set.h"
#include "sensor_agent/wire/rtps_parser.h"
#include "sensor_agent/wire/sip_hash.h"
#include "services/ros2/guid.h"

namespace rips::wire {

// Destinations told of one writer and source; further ones are counted together.
inline constexpr size_t kDestinationsMax = 8;
// Runs of sequence numbers told of one writer and source; further numbers are left out.
inline constexpr size_t kRunsMax = 8;

struct Destination {
  Locator to;
  uint64_t packets = 0;

  friend bool operator==(const Destination&, const Destination&) = default;
};

// What one writer sent from one source. rips.v1 (wire.proto) says what each means.
struct Traffic {
  // The entity id is zero for datagrams in which no writer is named.
  ros2::Guid writer;
  Locator source;
  uint16_t vendor = 0;
  uint64_t packets = 0;
  uint64_t data = 0;
  uint64_t data_frag = 0;
  uint64_t heartbeat = 0;
  uint64_t directed = 0;
  uint64_t secured = 0;
  uint64_t data_last = 0;
  uint64_t heartbeat_last = 0;
  uint64_t first_packet = 0;
  uint64_t last_packet = 0;
  // At most kDestinationsMax.
  std::vector<Destination> destinations;
  uint64_t elsewhere = 0;
  uint64_t data_least = 0;
  uint64_t heartbeat_least = 0;
  uint64_t dropped_last = 0;
  NumberSet numbers{kRunsMax, /*keep=*/true};
  uint64_t conflicts = 0;
  uint64_t conflict_number = 0;
  uint32_t conflict_size = 0;
  Locator conflict_to;

  friend bool operator==(const Traffic&, const Traffic&) = default;
};

// Totals since the tap started.
struct TapCounters {
  uint64_t packets = 0;
  uint64_t malformed = 0;
  uint64_t cut = 0;
  uint64_t kernel_drops = 0;
  uint64_t table_drops = 0;

  friend bool operator==(const TapCounters&, const TapCounters&) = default;
};

// What the tap tells at a time. An interval may take several; each traffic stands in one of them.
struct TapReport {
  uint32_t domain = 0;
  int64_t boottime_ns = 0;
  TapCounters counters;
  std::vector<Address> local_addresses;
  std::vector<Traffic> traffic;

  friend bool operator==(const TapReport&, const TapReport&) = default;
};

// Not thread-safe.
class TrafficTable {
 public:
  struct Limits {
    // Writers and sources of one interval. What is of others is counted in table_drops: a flood of
    // invented names does not push out those that are there.
    size_t entries = 4'096;
    int content_buckets_log2 = ContentTable::kBucketsLog2;
  };

  // `key` is secret and of this process.
  explicit TrafficTable(const SipKey& key) : TrafficTable(key, Limits{}) {}
  TrafficTable(const SipKey& key, Limits limits)
      : limits_(limits), contents_(key, limits.content_buckets_log2) {}

  // One datagram. `now_ns` is CLOCK_BOOTTIME.
  void Add(const RtpsDatagram& datagram, const Locator& source, const Locator& to, int64_t now_ns);
  void AddKernelDrops(uint64_t count) { counters_.kernel_drops += count; }

  // What came since the last call, sorted by writer and source, and begins the next interval.
  std::vector<Traffic> Take();

  const TapCounters& counters() const { return counters_; }
  bool empty() const { return entries_.empty(); }

 private:
  using Key = std::pair<ros2::Guid, Locator>;

  // Null if there is no room.
  Traffic* Obtain(const ros2::Guid& writer, const Locator& source);
  // Counts the datagram itself.
  static void Count(const RtpsDatagram& datagram, const Locator& to, uint64_t number,
                    Traffic& traffic);

  const Limits limits_;
  TapCounters counters_;
  absl::flat_hash_map<Key, Traffic> entries_;
  // Outlives the interval.
  ContentTable contents_;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_TRAFFIC_H_
