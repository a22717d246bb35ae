// Server of one ROS 2 service, as rmw_cyclonedds clients expect it.
#ifndef RIPS_TESTS_SUPPORT_ROS2_SERVICE_SERVER_H_
#define RIPS_TESTS_SUPPORT_ROS2_SERVICE_SERVER_H_

#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/dds/participant.h"
#include "services/dds/service_client.h"
#include "services/ros2/guid.h"

namespace rips::dds {

// Takes a request's CDR payload and gives the reply's; nullopt = stay silent. Runs on the
// server's own thread, one request at a time, and may take its time.
using ServiceHandler = std::function<std::optional<std::string>(absl::string_view request)>;

// Requests beyond this many waiting are dropped, the newest first.
inline constexpr size_t kServiceQueueMax = 64;

// Any thread. Must not outlive its participant.
class ServiceServer {
 public:
  static absl::StatusOr<std::unique_ptr<ServiceServer>> Create(const Participant& participant,
                                                               const ServiceOptions& options,
                                                               ServiceHandler handler);
  // Returns when the requests that wait have been handled.
  ~ServiceServer();

  ServiceServer(const ServiceServer&) = delete;
  ServiceServer& operator=(const ServiceServer&) = delete;

  // The two endpoints, for the node's list in ros_discovery_info.
  ros2::Guid request_reader() const;
  ros2::Guid reply_writer() const;

 private:
  struct Impl;
  explicit ServiceServer(std::unique_ptr<Impl> impl);

  std::unique_ptr<Impl> impl_;
};

}  // namespace rips::dds

#endif  // RIPS_TESTS_SUPPORT_ROS2_SERVICE_SERVER_H_
