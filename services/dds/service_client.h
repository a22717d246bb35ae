// Client of one ROS 2 service, served through rmw_cyclonedds or rmw_fastrtps.
#ifndef RIPS_SERVICES_DDS_SERVICE_CLIENT_H_
#define RIPS_SERVICES_DDS_SERVICE_CLIENT_H_

#include <memory>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/dds/participant.h"
#include "services/ros2/guid.h"

namespace rips::dds {

struct ServiceOptions {
  // ROS names: "/safety/change_mode", "system_modes_msgs/srv/ChangeMode".
  std::string service;
  std::string type;
};

// Keep it: the first contact costs up to a second of discovery, a call on a matched client well
// under a millisecond. Any thread; calls of one client run one after the other. Must not outlive
// its participant.
class ServiceClient {
 public:
  // InvalidArgument for a bad service or type name.
  static absl::StatusOr<std::unique_ptr<ServiceClient>> Create(const Participant& participant,
                                                               const ServiceOptions& options);
  ~ServiceClient();

  ServiceClient(const ServiceClient&) = delete;
  ServiceClient& operator=(const ServiceClient&) = delete;

  // A server's request reader and reply writer are both matched: a request now will reach it and
  // its reply will reach us.
  bool ServerReady() const;
  // Where the next request would go: the server's endpoint, another one after its restart.
  std::optional<ros2::Guid> Server() const;

  // Waits for ServerReady. DeadlineExceeded, naming the service, after `timeout`.
  absl::Status WaitForServer(absl::Duration timeout);

  // Sends `request` (a CDR payload) and gives the reply's payload. Waits for the server and for
  // the reply, `timeout` for both together: DeadlineExceeded says which was missing. A reply that
  // answers another client or another call is ignored. InvalidArgument if `request` is no CDR
  // payload. After a timeout the request may still take effect.
  absl::StatusOr<std::string> Call(absl::string_view request, absl::Duration timeout);

  const std::string& service() const;
  // The two endpoints, for the node's list in ros_discovery_info.
  ros2::Guid request_writer() const;
  ros2::Guid reply_reader() const;

 private:
  struct Impl;
  explicit ServiceClient(std::unique_ptr<Impl> impl);

  std::unique_ptr<Impl> impl_;
};

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_SERVICE_CLIENT_H_
