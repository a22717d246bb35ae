// A process that does what its own permissions forbid.
#ifndef RIPS_TESTS_SUPPORT_DDS_PEER_LAWLESS_H_
#define RIPS_TESTS_SUPPORT_DDS_PEER_LAWLESS_H_

namespace rips::dds_peer {

// From now on the middleware of this process makes every topic, reader and writer, whatever its
// permissions say: only others can refuse it. Call it before there is a participant.
void IgnoreOwnPermissions();

}  // namespace rips::dds_peer

#endif  // RIPS_TESTS_SUPPORT_DDS_PEER_LAWLESS_H_
