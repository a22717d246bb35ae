// A DDS domain as this process sees it, and participants in it.
#ifndef RIPS_SERVICES_DDS_PARTICIPANT_H_
#define RIPS_SERVICES_DDS_PARTICIPANT_H_

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "services/dds/dds_entity.h"
#include "services/dds/host_addresses.h"
#include "services/dds/own_endpoints.h"
#include "services/dds/security.h"
#include "services/ros2/guid.h"

namespace rips::dds {

struct DomainOptions {
  // 0..232 (DDSI-RTPS 2.5 §9.6.2.3: beyond, the ports do not fit 16 bits).
  uint32_t id = 0;
  // Network interface to speak on ("lo", "eth0"); empty = Cyclone chooses. Used only when the
  // environment has no CYCLONEDDS_URI: an operator's own configuration wins whole.
  std::string interface;
  // Readers announce no multicast address, so that no writer sends its data by multicast for them:
  // that would reach every process of the domain on the host. Costs such a writer one more send.
  bool unicast_data = false;
};

// The environment has CYCLONEDDS_URI.
bool OperatorsOwnConfiguration();

// NotFound, with those that there are; Unavailable of one that is down or has no IPv4 address. OK
// of an empty name, and where CYCLONEDDS_URI decides.
absl::Status FindInterface(const std::string& name);

// The XML with which a domain starts when CYCLONEDDS_URI is unset. `rmem_max` is the largest
// socket receive buffer the kernel grants, in bytes (/proc/sys/net/core/rmem_max): Cyclone
// refuses to start if it asks for more. InvalidArgument if `interface` is no interface name.
absl::StatusOr<std::string> DomainXml(const DomainOptions& options, uint64_t rmem_max);

// One per domain id and process. Any thread. Must outlive everything in it, which a Participant
// ensures by sharing it.
class Domain {
 public:
  // AlreadyExists if this process has that domain already; as FindInterface; Unavailable if Cyclone
  // cannot begin one, as it cannot without an interface that it may use.
  static absl::StatusOr<std::shared_ptr<const Domain>> Create(const DomainOptions& options);
  Domain(const Domain&) = delete;
  Domain& operator=(const Domain&) = delete;
  // Ends also where its interface has another address by now.
  ~Domain();

  uint32_t id() const { return id_; }

 private:
  Domain(uint32_t id, DdsEntity entity) : id_(id), entity_(std::move(entity)) {}

  uint32_t id_;
  DdsEntity entity_;
};

// Begins a domain and ends it again; the errors of Domain::Create.
absl::Status TryDomain(const DomainOptions& options);
// An error of Domain::Create that may pass when the host's addresses change.
bool MayComeWithAnInterface(const absl::Status& status);

struct ParticipantOptions {
  // ROS enclave, announced as user data "enclave=/;". Under `security` that one's name.
  std::string enclave = "/";
  // With DDS Security as this enclave. All participants of a domain in this process have it, or
  // none.
  std::optional<Enclave> security;
};

// Any thread. Must outlive every reader, writer and service made from it.
class Participant {
 public:
  // FailedPrecondition if the configuration turns shared memory on: payloads would then bypass
  // what we can read. PermissionDenied or Internal if DDS Security cannot be had; LoadEnclave finds
  // most of the reasons before, with better messages.
  static absl::StatusOr<std::unique_ptr<Participant>> Create(
      std::shared_ptr<const Domain> domain, const ParticipantOptions& options = {});
  // With a domain of its own; the usual case: one participant per process.
  static absl::StatusOr<std::unique_ptr<Participant>> Create(
      const DomainOptions& domain, const ParticipantOptions& options = {});

  EntityHandle entity() const { return entity_.get(); }
  const ros2::Guid& guid() const { return guid_; }
  // It uses DDS Security.
  bool secured() const { return secured_; }
  uint32_t domain_id() const { return domain_->id(); }
  // What RawReader and RawWriter have made in it.
  const std::shared_ptr<OwnEndpoints>& own_endpoints() const { return own_endpoints_; }
  // Also after they have gone from the host.
  const InterfacesInUse& interfaces() const { return interfaces_; }
  // For a further participant in the same domain.
  const std::shared_ptr<const Domain>& domain() const { return domain_; }

 private:
  Participant(std::shared_ptr<const Domain> domain, DdsEntity entity, const ros2::Guid& guid,
              bool secured, InterfacesInUse interfaces)
      : domain_(std::move(domain)),
        entity_(std::move(entity)),
        guid_(guid),
        secured_(secured),
        interfaces_(std::move(interfaces)) {}

  std::shared_ptr<const Domain> domain_;
  DdsEntity entity_;  // after domain_: goes first
  ros2::Guid guid_;
  bool secured_;
  InterfacesInUse interfaces_;
  std::shared_ptr<OwnEndpoints> own_endpoints_ = std::make_shared<OwnEndpoints>();
};

// GUID of any entity of this process.
absl::StatusOr<ros2::Guid> GuidOf(EntityHandle entity);

}  // namespace rips::dds

#endif  // RIPS_SERVICES_DDS_PARTICIPANT_H_
