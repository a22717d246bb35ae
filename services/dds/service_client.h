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

// What a call does when several servers offer the service. No reply counts then: any participant on
// the bus can offer it, and which server is the robot's cannot be told.
enum class IfSeveral {
  kAskNone,
  kSendToAll,  // the request goes out all the same, so that the robot's own server has it
};

// The middleware of a client that did not hear from a server may be deaf to it: one forged
// heartbeat in the name of the client's writer makes the server's reader drop what the client sends
// from then on. So the next call makes both endpoints new, at the first time at once, then after
// pauses that double between these, until a reply comes.
inline constexpr absl::Duration kRenewPauseMin = absl::Seconds(1);
inline constexpr absl::Duration kRenewPauseMax = absl::Seconds(64);

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

  // The request reader and the reply writer of a server are both matched: a request now will reach
  // it and its reply will reach us. There may be several such servers.
  bool ServerReady() const;
  // Where the next request would go: the server's endpoint, another one after its restart. nullopt
  // if there is no server, or several.
  std::optional<ros2::Guid> Server() const;

  // Waits for ServerReady. DeadlineExceeded, naming the service, after `timeout`.
  absl::Status WaitForServer(absl::Duration timeout);

  // Sends `request` (a CDR payload) and gives the reply's payload. Waits for the server and for
  // the reply, `timeout` for both together: DeadlineExceeded says which was missing. Only the one
  // server there is can reply: a reply of another writer, or one that answers another client or
  // another call, is ignored. FailedPrecondition, naming participants, if there are several
  // servers. InvalidArgument if `request` is no CDR payload. After a timeout the request may still
  // take effect.
  absl::StatusOr<std::string> Call(absl::string_view request, absl::Duration timeout,
                                   IfSeveral if_several = IfSeveral::kAskNone);

  // The server may be deaf to this client: the next call makes the endpoints new, unless that was
  // done a short time ago. A call that gets no reply in time does so itself.
  void Suspect();

  const std::string& service() const;
  // The two endpoints, for the node's list in ros_discovery_info. Others once they are made new.
  ros2::Guid request_writer() const;
  ros2::Guid reply_reader() const;

 private:
  struct Impl;
  explicit ServiceClient(std::unique_ptr<Impl> impl);

  std::unique_ptr<Impl> impl_;
};

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_SERVICE_CLIENT_H_
