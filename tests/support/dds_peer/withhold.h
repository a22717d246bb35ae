// Datagrams of this process that are not sent.
#ifndef RIPS_TESTS_SUPPORT_DDS_PEER_WITHHOLD_H_
#define RIPS_TESTS_SUPPORT_DDS_PEER_WITHHOLD_H_

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace rips::dds_peer {

// From now on whatever library of this process sends a datagram to `place` ("10.0.0.1:17417", IPv4)
// is told that it went out, and nothing does. One place; call it before there are other threads.
// InvalidArgument if that is no place.
absl::Status Withhold(absl::string_view place);

}  // namespace rips::dds_peer

#endif  // RIPS_TESTS_SUPPORT_DDS_PEER_WITHHOLD_H_
