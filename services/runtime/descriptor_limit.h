// How many descriptors this process may have open.
#ifndef RIPS_SERVICES_RUNTIME_DESCRIPTOR_LIMIT_H_
#define RIPS_SERVICES_RUNTIME_DESCRIPTOR_LIMIT_H_

#include <cstdint>

namespace rips {

// Raises the soft limit to `wanted`, or as far as the hard limit allows; never lowers it. Gives the
// limit that is in force then. Call it before there are many threads.
uint64_t RaiseDescriptorLimit(uint64_t wanted);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_DESCRIPTOR_LIMIT_H_
