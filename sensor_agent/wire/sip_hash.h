// SipHash-1-3 (Aumasson, Bernstein 2012): a hash of bytes under a key that others do not know, so
// that they cannot choose bytes of one hash.
#ifndef RIPS_SENSOR_AGENT_WIRE_SIP_HASH_H_
#define RIPS_SENSOR_AGENT_WIRE_SIP_HASH_H_

#include <cstdint>

#include "absl/strings/string_view.h"

namespace rips::wire {

struct SipKey {
  uint64_t low = 0;
  uint64_t high = 0;
};

uint64_t SipHash(const SipKey& key, absl::string_view bytes);

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_SIP_HASH_H_
