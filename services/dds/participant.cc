#include "services/dds/participant.h"

#include <net/if.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "dds/dds.h"
#include "dds/ddsrt/log.h"
#include "services/base/status_macros.h"
#include "services/dds/qos.h"
#include "services/dds/raw_type.h"
#include "services/dds/receiver_waker.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/daemon_log.h"

namespace rips::dds {
namespace {

constexpr uint32_t kDomainIdMax = 232;
// IFNAMSIZ without the terminator.
constexpr size_t kInterfaceCharsMax = 15;
// Best-effort samples of several megabytes are lost whole with less.
constexpr uint64_t kReceiveBufferBytes = 4 << 20;

uint64_t ReadRmemMax() {
  uint64_t bytes = 0;
  std::ifstream("/proc/sys/net/core/rmem_max") >> bytes;
  return bytes;
}

bool IsInterfaceName(absl::string_view name) {
  return name.size() <= kInterfaceCharsMax && std::all_of(name.begin(), name.end(), [](char c) {
           return absl::ascii_isalnum(c) ||
                  absl::string_view("_-.:@").find(c) != absl::string_view::npos;
         });
}

// DDS Security 1.1 §9.3.1, §9.4.1, and what the middleware calls its plugins.
void SetSecurity(dds_qos_t* qos, const Enclave& enclave) {
  const auto set = [qos](const char* name, const std::string& value) {
    dds_qset_prop(qos, name, value.c_str());
  };
  const auto set_file = [&set](const char* name, const std::string& path) {
    if (!path.empty()) set(name, absl::StrCat("file:", path));
  };
  set("dds.sec.auth.library.path", "dds_security_auth");
  set("dds.sec.auth.library.init", "init_authentication");
  set("dds.sec.auth.library.finalize", "finalize_authentication");
  set("dds.sec.crypto.library.path", "dds_security_crypto");
  set("dds.sec.crypto.library.init", "init_crypto");
  set("dds.sec.crypto.library.finalize", "finalize_crypto");
  set("dds.sec.access.library.path", "dds_security_ac");
  set("dds.sec.access.library.init", "init_access_control");
  set("dds.sec.access.library.finalize", "finalize_access_control");
  set_file("dds.sec.auth.identity_ca", enclave.identity_ca);
  set_file("dds.sec.auth.identity_certificate", enclave.certificate);
  set_file("dds.sec.auth.private_key", enclave.private_key);
  set_file("dds.sec.access.permissions_ca", enclave.permissions_ca);
  set_file("dds.sec.access.governance", enclave.governance);
  set_file("dds.sec.access.permissions", enclave.permissions);
  set_file("org.eclipse.cyclonedds.sec.auth.crl", enclave.crl);
}

// `lo, eth0`
std::string InterfaceNames() {
  const std::unique_ptr<struct if_nameindex, void (*)(struct if_nameindex*)> list(if_nameindex(),
                                                                                  if_freenameindex);
  std::vector<std::string> names;
  for (const auto* each = list.get(); each != nullptr && each->if_index != 0; ++each) {
    names.push_back(ros2::Printable(each->if_name));
  }
  return names.empty() ? "none" : absl::StrJoin(names, ", ");
}

// The middleware writes by itself to standard error otherwise, unformatted and unlimited. A trace
// that the operator's CYCLONEDDS_URI asks for goes where that says.
void RouteDdsLogs() {
  static std::once_flag once;
  std::call_once(once, [] {
    dds_set_log_sink(
        [](void*, const dds_log_data_t* line) {
          const LogLevel level = (line->priority & (DDS_LC_FATAL | DDS_LC_ERROR)) != 0
                                     ? LogLevel::kError
                                 : (line->priority & DDS_LC_WARNING) != 0 ? LogLevel::kWarning
                                                                          : LogLevel::kInfo;
          LogOfLibrary(level, "dds", line->message);
        },
        nullptr);
  });
}

}  // namespace

bool OperatorsOwnConfiguration() {
  const char* own = std::getenv("CYCLONEDDS_URI");
  return own != nullptr && *own != '\0';
}

absl::Status FindInterface(const std::string& name) {
  if (OperatorsOwnConfiguration() || name.empty()) return absl::OkStatus();
  if (if_nametoindex(name.c_str()) == 0) {
    return absl::NotFoundError(absl::StrCat("there is no network interface `", name,
                                            "` here, only ", InterfaceNames(),
                                            "; see `dds.interface`"));
  }
  const absl::StatusOr<std::vector<InterfaceAddress>> host = HostAddresses();
  if (!host.ok()) return absl::OkStatus();  // Cyclone finds out
  const bool usable = std::any_of(host->begin(), host->end(), [&](const InterfaceAddress& each) {
    return each.interface == name && !each.ipv6;
  });
  if (usable) return absl::OkStatus();
  return absl::UnavailableError(absl::StrCat("network interface `", name,
                                             "` is down or has no IPv4 address; see "
                                             "`dds.interface`"));
}

absl::Status TryDomain(const DomainOptions& options) { return Domain::Create(options).status(); }

bool MayComeWithAnInterface(const absl::Status& status) {
  return absl::IsNotFound(status) || absl::IsUnavailable(status);
}

absl::StatusOr<std::string> DomainXml(const DomainOptions& options, uint64_t rmem_max) {
  if (!IsInterfaceName(options.interface)) {
    return absl::InvalidArgumentError(absl::StrCat("`", ros2::Printable(options.interface),
                                                   "` is not a network interface; see `ip link`"));
  }
  std::string general;
  if (!options.interface.empty()) {
    // The loopback interface carries multicast although it lacks the flag that says so.
    general =
        absl::StrCat("<Interfaces><NetworkInterface name=\"", options.interface, "\" multicast=\"",
                     options.interface == "lo" ? "true" : "default", "\"/></Interfaces>");
  }
  if (options.unicast_data) absl::StrAppend(&general, "<AllowMulticast>spdp</AllowMulticast>");
  std::string internal;
  if (const uint64_t bytes = std::min(rmem_max, kReceiveBufferBytes); bytes > 0) {
    internal = absl::StrCat("<Internal><SocketReceiveBufferSize min=\"", bytes, "B\"/></Internal>");
  }
  // Without an index there is no bound on the participants of a host; discovery is by multicast.
  return absl::StrCat("<CycloneDDS><Domain><General>", general,
                      "</General><Discovery><ParticipantIndex>none</ParticipantIndex></Discovery>",
                      internal, "</Domain></CycloneDDS>");
}

absl::StatusOr<std::shared_ptr<const Domain>> Domain::Create(const DomainOptions& options) {
  if (options.id > kDomainIdMax) {
    return absl::InvalidArgumentError(
        absl::StrCat("domain ", options.id, " exceeds limit ", kDomainIdMax));
  }
  RIPS_ASSIGN_OR_RETURN(std::string xml, DomainXml(options, ReadRmemMax()));
  if (OperatorsOwnConfiguration()) xml = std::getenv("CYCLONEDDS_URI");
  RIPS_RETURN_IF_ERROR(FindInterface(options.interface));
  RouteDdsLogs();
  DdsEntity entity(dds_create_domain(options.id, xml.c_str()));
  if (entity.get() == DDS_RETCODE_PRECONDITION_NOT_MET) {
    return absl::AlreadyExistsError(
        absl::StrCat("domain ", options.id, " exists in this process already"));
  }
  if (entity.get() < 0) {
    const absl::Status error = DdsError(absl::StrCat("creating domain ", options.id), entity.get());
    return absl::UnavailableError(absl::StrCat(
        error.message(),
        OperatorsOwnConfiguration() ? "; is there a network interface such as CYCLONEDDS_URI names?"
        : options.interface.empty() ? "; is there a network interface with an address?"
                                    : absl::StrCat(" on interface `", options.interface, "`")));
  }
  return std::shared_ptr<const Domain>(new Domain(options.id, std::move(entity)));
}

Domain::~Domain() {
  const ReceiverWaker waker;
  entity_.Reset();
}

absl::StatusOr<std::unique_ptr<Participant>> Participant::Create(
    std::shared_ptr<const Domain> domain, const ParticipantOptions& options) {
  const bool secured = options.security.has_value();
  const std::string& enclave = secured ? options.security->name : options.enclave;
  const OwnedQos qos = MakeQos(absl::StrCat("enclave=", enclave, ";"));
  if (secured) SetSecurity(qos.get(), *options.security);
  DdsEntity entity(dds_create_participant(domain->id(), qos.get(), nullptr));
  if (entity.get() < 0) {
    return DdsError(absl::StrCat("creating a participant in domain ", domain->id(),
                                 secured ? absl::StrCat(" as enclave `", enclave, "`") : ""),
                    entity.get());
  }
  RIPS_ASSIGN_OR_RETURN(
      InterfacesInUse in_use,
      ExamineDomain(entity.get(), secured ? options.security->permitted_topic : "rips_probe"));
  RIPS_ASSIGN_OR_RETURN(const ros2::Guid guid, GuidOf(entity.get()));
  return std::unique_ptr<Participant>(
      new Participant(std::move(domain), std::move(entity), guid, secured, std::move(in_use)));
}

absl::StatusOr<std::unique_ptr<Participant>> Participant::Create(
    const DomainOptions& domain, const ParticipantOptions& options) {
  RIPS_ASSIGN_OR_RETURN(std::shared_ptr<const Domain> created, Domain::Create(domain));
  return Create(std::move(created), options);
}

absl::StatusOr<ros2::Guid> GuidOf(EntityHandle entity) {
  dds_guid_t guid;
  if (const dds_return_t code = dds_get_guid(entity, &guid); code < 0) {
    return DdsError("reading an entity's GUID", code);
  }
  return ToGuid(guid);
}

}  // namespace rips::dds
