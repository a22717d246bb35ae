#include "services/dds/service_endpoints.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "dds/dds.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/dds/qos.h"
#include "services/ros2/ros_name.h"

namespace rips::dds {
namespace {

// Requests and replies waiting in one endpoint; what rmw's service profile asks.
constexpr uint32_t kServiceDepth = 10;
// Of requests that no server has acknowledged when the client ends.
constexpr absl::Duration kClientLinger = absl::Milliseconds(100);
// Matched peers looked at.
constexpr size_t kPeersMax = 256;
// Kept of a sample; replies of parameters may hold arrays.
constexpr uint32_t kServiceBytesMax = 1U << 20;

struct Peer {
  std::string service_id;
  ros2::Guid participant;
  ros2::Guid endpoint;

  bool IsFastDds() const {
    return service_id.empty() && participant.bytes[0] == 0x01 && participant.bytes[1] == 0x0f;
  }

  // Anybody can copy a service id, so the participant counts as well.
  bool SameServer(const Peer& other) const {
    return participant == other.participant && service_id == other.service_id;
  }
};

// As rmw_cyclonedds writes it: 16 bytes in hex without leading zeros, joined by dots, the first
// one padded to two characters.
std::string UserData(ServiceSide side) {
  const std::string bytes = absl::HexStringToBytes(NewId());
  std::string text;
  for (char byte : bytes) {
    const auto value = static_cast<uint8_t>(byte);
    if (text.empty()) {
      absl::StrAppend(&text, absl::Hex(value, absl::kSpacePad2));
    } else {
      absl::StrAppend(&text, ".", absl::Hex(value));
    }
  }
  return absl::StrCat(side == ServiceSide::kClient ? "clientid=" : "serviceid=", text, ";");
}

using ListMatched = dds_return_t (*)(dds_entity_t, dds_instance_handle_t*, size_t);
using DescribeMatched = dds_builtintopic_endpoint_t* (*)(dds_entity_t, dds_instance_handle_t);

struct Peers {
  std::vector<Peer> all;
  bool truncated = false;
};

Peers PeersOf(EntityHandle entity, ListMatched list, DescribeMatched describe) {
  std::vector<dds_instance_handle_t> handles(kPeersMax);
  const dds_return_t count = list(entity, handles.data(), handles.size());
  Peers peers;
  peers.truncated = count > static_cast<dds_return_t>(kPeersMax);
  handles.resize(std::min(handles.size(), static_cast<size_t>(std::max(count, 0))));
  for (dds_instance_handle_t handle : handles) {
    dds_builtintopic_endpoint_t* data = describe(entity, handle);
    if (data == nullptr) continue;  // gone in the meantime
    Peer peer;
    peer.service_id = UserDataField(ReadUserData(data->qos), "serviceid");
    peer.participant = ToGuid(data->participant_key);
    peer.endpoint = ToGuid(data->key);
    dds_builtintopic_free_endpoint(data);
    peers.all.push_back(std::move(peer));
  }
  return peers;
}

Peers ReadersMatchedBy(const RawWriter& writer) {
  return PeersOf(writer.entity(), dds_get_matched_subscriptions, dds_get_matched_subscription_data);
}

}  // namespace

absl::StatusOr<ServiceEndpoints> CreateServiceEndpoints(const Participant& participant,
                                                        const ServiceOptions& options,
                                                        ServiceSide side,
                                                        ServiceCallback on_sample) {
  RIPS_RETURN_IF_ERROR(ros2::ValidateTopicName(options.service));
  RIPS_RETURN_IF_ERROR(ros2::ValidateTopicName(absl::StrCat("/", options.type)));
  const std::string request = ros2::MangleServiceRequest(options.service);
  const std::string request_type = ros2::MangleServiceRequestType(options.type);
  const std::string reply = ros2::MangleServiceReply(options.service);
  const std::string reply_type = ros2::MangleServiceReplyType(options.type);
  const std::string user_data = UserData(side);
  const bool client = side == ServiceSide::kClient;

  ServiceEndpoints endpoints;
  RIPS_ASSIGN_OR_RETURN(
      endpoints.writer,
      RawWriter::Create(participant,
                        {.topic = client ? request : reply,
                         .type = client ? request_type : reply_type,
                         .qos = {.reliable = true, .depth = kServiceDepth, .partitions = {}},
                         .user_data = user_data}));
  // The end of a domain waits for one writer after the other: a client whose servers are gone, as
  // after a change of address, would take Cyclone's second for each service.
  if (client) endpoints.writer->LimitLinger(kClientLinger);
  RIPS_ASSIGN_OR_RETURN(
      endpoints.reader,
      RawReader::Create(participant,
                        {.topic = client ? reply : request,
                         .type = client ? reply_type : request_type,
                         .reliable = true,
                         .depth = kServiceDepth,
                         .payload_bytes_max = kServiceBytesMax,
                         .every_partition = false,
                         .ignore_own = false,
                         .user_data = user_data},
                        [writer = endpoints.writer.get(), on_sample = std::move(on_sample)](
                            const RawSample& sample) { on_sample(*writer, sample); }));
  return endpoints;
}

ServersFound FindServers(const ServiceEndpoints& client) {
  ServersFound found;
  const Peers readers = ReadersMatchedBy(*client.writer);
  if (readers.all.empty()) return found;
  const Peers writers = PeersOf(client.reader->entity(), dds_get_matched_publications,
                                dds_get_matched_publication_data);
  found.truncated = readers.truncated || writers.truncated;
  for (const Peer& reader : readers.all) {
    for (const Peer& writer : writers.all) {
      if (!reader.SameServer(writer)) continue;
      found.servers.push_back({.request_reader = reader.endpoint,
                               .reply_writer = writer.endpoint,
                               .fastrtps = reader.IsFastDds()});
    }
  }
  std::sort(found.servers.begin(), found.servers.end(),
            [](const WholeServer& a, const WholeServer& b) {
              return a.request_reader < b.request_reader;
            });
  return found;
}

bool MatchesReaderOf(const RawWriter& writer, const ros2::Guid& participant) {
  const Peers readers = ReadersMatchedBy(writer);
  return std::any_of(readers.all.begin(), readers.all.end(),
                     [&](const Peer& reader) { return reader.participant == participant; });
}

}  // namespace rips::dds
