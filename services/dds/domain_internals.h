// A look into Cyclone's configuration from C, since ddsi_domaingv.h does not compile as C++.
// Internal to services/dds.
#ifndef RIPS_SERVICES_DDS_DOMAIN_INTERNALS_H_
#define RIPS_SERVICES_DDS_DOMAIN_INTERNALS_H_

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct ddsi_sertype;

// `type` is in use by a topic. True if its domain's configuration has shared memory on.
bool rips_dds_uses_shared_memory(const struct ddsi_sertype* type);

// RawWriter::LimitLinger. `type` is in use by a topic.
void rips_dds_limit_linger(const struct ddsi_sertype* type, int64_t longest_ns);

// An address that a domain took when it began.
struct rips_dds_interface {
  const char* name;  // lives as long as the domain
  uint32_t index;
  bool ipv6;
  uint8_t address[16];  // IPv4: the last four bytes
};
// `type` is in use by a topic. Fills at most `max` of `into` and returns how many. `automatic` is
// true if Cyclone chose them itself.
size_t rips_dds_interfaces(const struct ddsi_sertype* type, struct rips_dds_interface* into,
                           size_t max, bool* automatic);

#ifdef __cplusplus
}
#endif

#endif  // RIPS_SERVICES_DDS_DOMAIN_INTERNALS_H_
