// The two endpoints that make one side of a service. Internal to services/dds.
#ifndef RIPS_SERVICES_DDS_SERVICE_ENDPOINTS_H_
#define RIPS_SERVICES_DDS_SERVICE_ENDPOINTS_H_

#include <functional>
#include <memory>
#include <optional>

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

// A peer that is matched by `writer` and by `reader`, and both of whose endpoints carry the same
// "serviceid", or, if they carry none, belong to one participant. Of several, one of rmw_cyclonedds.
struct WholeServer {
  ros2::Guid request_reader;
  // It pairs replies with requests as rmw_fastrtps does: no header in the payload, but a related
  // sample identity beside it. Known by the vendor in the GUID (DDSI-RTPS 2.5 §9.3.1.5).
  bool fastrtps = false;
};
std::optional<WholeServer> FindWholeServer(const ServiceEndpoints& client);

// Some reader of `participant` is matched by `writer`.
bool MatchesReaderOf(const RawWriter& writer, const ros2::Guid& participant);

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_SERVICE_ENDPOINTS_H_
