// A look into Cyclone's configuration from C, since ddsi_domaingv.h does not compile as C++.
// Internal to services/dds.
#ifndef RIPS_SERVICES_DDS_SHARED_MEMORY_H_
#define RIPS_SERVICES_DDS_SHARED_MEMORY_H_

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

struct ddsi_sertype;

// `type` is in use by a topic. True if its domain's configuration has shared memory on.
bool rips_dds_uses_shared_memory(const struct ddsi_sertype* type);

#ifdef __cplusplus
}
#endif

#endif  // RIPS_SERVICES_DDS_SHARED_MEMORY_H_
