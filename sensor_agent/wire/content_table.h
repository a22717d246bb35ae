// Whether each sample has one content, whomever it is sent to: a writer serializes a sample once,
// and a retransmission has the same bytes.
#ifndef RIPS_SENSOR_AGENT_WIRE_CONTENT_TABLE_H_
#define RIPS_SENSOR_AGENT_WIRE_CONTENT_TABLE_H_

#include <cstddef>
#include <cstdint>
#include <vector>

#include "sensor_agent/wire/rtps_parser.h"
#include "sensor_agent/wire/sip_hash.h"
#include "services/base/clock.h"

namespace rips::wire {

// Remembers, of the newest samples of all writers, hashes under a key of this process; memory is
// allocated once. Not thread-safe.
class ContentTable {
 public:
  // Samples and fragments that are remembered, at most: 2^kBucketsLog2 buckets of kWays. A new one
  // takes the place of the oldest of its bucket.
  static constexpr int kBucketsLog2 = 14;
  static constexpr size_t kWays = 4;
  // Bytes of a content that are compared, from its beginning: those of every one are at hand, also
  // where a retransmission has more headers before them, and a fragment of Cyclone DDS is shorter.
  static constexpr size_t kBytesCompared = 1'408;
  // Then it is forgotten: a process that has been started again under its old name counts from 1.
  static constexpr int64_t kKeptNs = 10 * kNanosPerSecond;

  // `buckets_log2`: 1 to 32.
  explicit ContentTable(const SipKey& key, int buckets_log2 = kBucketsLog2)
      : key_(key), buckets_log2_(buckets_log2), entries_(kWays << buckets_log2) {}

  // True if this sample, or this fragment of it, was seen with another content: other bytes as far
  // as they are compared, another size, or a payload where there was none. Of DATA and DATA_FRAG;
  // false if those bytes are not at hand.
  bool Differs(const RtpsSubmessage& data, int64_t now_ns);

 private:
  struct Entry {
    uint64_t name = 0;  // 0 = empty
    uint64_t content = 0;
    int64_t seen_ns = 0;
  };

  const SipKey key_;
  const int buckets_log2_;
  std::vector<Entry> entries_;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_CONTENT_TABLE_H_
