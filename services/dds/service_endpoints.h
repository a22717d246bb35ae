// The two endpoints that make one side of a service. Internal to services/dds.
#ifndef RIPS_SERVICES_DDS_SERVICE_ENDPOINTS_H_
#define RIPS_SERVICES_DDS_SERVICE_ENDPOINTS_H_

#include <functional>
#include <memory>
#include <vector>

#include "absl/status/statusor.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/dds/service_client.h"
#include "services/ros2/guid.h"

namespace rips::dds {

enum class ServiceSide { kClient, kServer };

struct ServiceEndpoints {
  std::unique_ptr<RawWriter> writer;  // of requests, or of replies
  std::unique_ptr<RawReader> reader;  // of replies, or of requests; goes first
};

// Both endpoints carry the same random "clientid=..;" or "serviceid=..;" as user data, by which
// the peer knows that they belong together. InvalidArgument for a bad name. `on_sample` may run
// before this returns, but only once the writer exists: it is handed over with each sample.
using ServiceCallback = std::function<void(RawWriter&, const RawSample&)>;
absl::StatusOr<ServiceEndpoints> CreateServiceEndpoints(const Participant& participant,
                                                        const ServiceOptions& options,
                                                        ServiceSide side,
                                                        ServiceCallback on_sample);

// A server of the service, as seen by a client: a reader of requests and a writer of replies of one
// participant, both matched, and both with the same "serviceid" or both without one.
struct WholeServer {
  ros2::Guid request_reader;
  ros2::Guid reply_writer;  // only its samples are replies of this server
  // It pairs replies with requests as rmw_fastrtps does: no header in the payload, but a related
  // sample identity beside it. Known by the vendor in the GUID (DDSI-RTPS 2.5 §9.3.1.5).
  bool fastrtps = false;
};
struct ServersFound {
  std::vector<WholeServer> servers;  // in the order of their request readers' GUIDs
  // More endpoints are matched than are looked at: some servers may be missing above.
  bool truncated = false;

  bool none() const { return servers.empty() && !truncated; }
  // The only server there is; null if there is none, or several.
  const WholeServer* sole() const {
    return servers.size() == 1 && !truncated ? &servers.front() : nullptr;
  }
};
ServersFound FindServers(const ServiceEndpoints& client);

// Some reader of `participant` is matched by `writer`.
bool MatchesReaderOf(const RawWriter& writer, const ros2::Guid& participant);

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_SERVICE_ENDPOINTS_H_
