// Who is in the domain: participants and endpoints as the middleware discovers them
// (DDSI-RTPS 2.5 §8.5), reported as they come and go.
#ifndef RIPS_SERVICES_DDS_DISCOVERY_H_
#define RIPS_SERVICES_DDS_DISCOVERY_H_

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "services/dds/participant.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::dds {

// When `alive` is false only `guid` and `instance` mean anything.
struct ParticipantSeen {
  bool alive = false;
  ros2::Guid guid;
  InstanceHandle instance = 0;
  // All of this is what the participant says of itself, made printable.
  // From user data "enclave=/x;"; empty if not given, and under DDS Security if its GUID does not
  // prove it.
  std::string enclave;
  std::string host;  // empty, and pid 0, for participants that do not announce it
  std::string process;
  uint32_t pid = 0;
  // First two bytes of the GUID prefix as 4 hex digits, "0110" = Cyclone, "010f" = Fast DDS. By
  // convention only, and meaningless under DDS Security.
  std::string vendor;
  // Locators it is reached at, as Cyclone prints them.
  std::string addresses;
};

// When `alive` is false only `writer`, `guid`, `participant` and `instance` mean anything.
struct EndpointSeen {
  bool alive = false;
  bool writer = false;  // else reader
  ros2::Guid guid;
  ros2::Guid participant;
  // Of a writer: equal to RawSample::publication.
  InstanceHandle instance = 0;
  // DDS names as announced: untrusted bytes.
  std::string topic;
  std::string type;
  ros2::Qos qos;
  // Of a writer: why no RawReader can match it, whatever its options, but for DDS Security; empty =
  // one can.
  std::string unreadable;
  // "typehash=..;", "serviceid=..;" or whatever else.
  std::string user_data;
};

struct DiscoveryCallbacks {
  // On Cyclone's threads, or on the thread in Create; calls never overlap. Copy, enqueue, return.
  // A change of user data or QoS comes as another call with `alive`. Our own participants and
  // endpoints are reported too; Cyclone's built-in ones are not.
  std::function<void(const ParticipantSeen&)> on_participant;
  std::function<void(const EndpointSeen&)> on_endpoint;
};

// Any thread. Must not outlive its participant.
class Discovery {
 public:
  // What is known already is reported before or soon after Create returns.
  static absl::StatusOr<std::unique_ptr<Discovery>> Create(const Participant& participant,
                                                           DiscoveryCallbacks callbacks);
  // Returns when no callback runs any more. Not from within a callback.
  ~Discovery();

  Discovery(const Discovery&) = delete;
  Discovery& operator=(const Discovery&) = delete;

 private:
  struct Impl;
  explicit Discovery(std::unique_ptr<Impl> impl);

  std::unique_ptr<Impl> impl_;
};

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_DISCOVERY_H_
