#include "sensor_agent/wire/content_table.h"

#include <algorithm>
#include <array>
#include <cstring>

namespace rips::wire {

bool ContentTable::Differs(const RtpsSubmessage& data, int64_t now_ns) {
  const size_t compared = std::min<size_t>(data.content_size, kBytesCompared);
  if (data.content_unknown || data.content.size() < compared) return false;
  std::array<char, 28> name{};
  std::memcpy(name.data(), data.writer.bytes.data(), data.writer.bytes.size());
  std::memcpy(name.data() + 16, &data.sequence, sizeof data.sequence);
  std::memcpy(name.data() + 24, &data.fragment, sizeof data.fragment);
  // Zero is the empty entry.
  const uint64_t named = SipHash(key_, {name.data(), name.size()}) | 1;
  const uint64_t content = SipHash(key_, data.content.substr(0, compared)) + data.content_size;
  Entry* const bucket = &entries_[(named >> (64 - buckets_log2_)) * kWays];
  Entry* oldest = bucket;
  for (Entry* each = bucket; each < bucket + kWays; ++each) {
    if (each->name == named && now_ns - each->seen_ns < kKeptNs) return each->content != content;
    if (each->seen_ns < oldest->seen_ns) oldest = each;
  }
  *oldest = {.name = named, .content = content, .seen_ns = now_ns};
  return false;
}

}  // namespace rips::wire
