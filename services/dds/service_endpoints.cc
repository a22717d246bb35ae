#include "services/dds/service_endpoints.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "dds/dds.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/dds/qos.h"
#include "services/ros2/ros_name.h"

namespace rips::dds {
namespace {

// Requests and replies waiting in one endpoint; what rmw's service profile asks.
constexpr uint32_t kServiceDepth = 10;
// Matched peers looked at.
constexpr size_t kPeersMax = 256;

struct Peer {
  std::string service_id;
  ros2::Guid participant;
  ros2::Guid endpoint;

  bool IsFastDds() const {
    return service_id.empty() && participant.bytes[0] == 0x01 && participant.bytes[1] == 0x0f;
  }

  bool SameServer(const Peer& other) const {
    return service_id.empty() && other.service_id.empty() ? participant == other.participant
                                                          : service_id == other.service_id;
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

std::vector<Peer> PeersOf(EntityHandle entity, ListMatched list, DescribeMatched describe) {
  std::vector<dds_instance_handle_t> handles(kPeersMax);
  const dds_return_t count = list(entity, handles.data(), handles.size());
  handles.resize(std::min(handles.size(), static_cast<size_t>(std::max(count, 0))));
  std::vector<Peer> peers;
  for (dds_instance_handle_t handle : handles) {
    dds_builtintopic_endpoint_t* data = describe(entity, handle);
    if (data == nullptr) continue;  // gone in the meantime
    Peer peer;
    peer.service_id = UserDataField(ReadUserData(data->qos), "serviceid");
    peer.participant = ToGuid(data->participant_key);
    peer.endpoint = ToGuid(data->key);
    dds_builtintopic_free_endpoint(data);
    peers.push_back(std::move(peer));
  }
  return peers;
}

std::vector<Peer> ReadersMatchedBy(const RawWriter& writer) {
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
  RIPS_ASSIGN_OR_RETURN(
      endpoints.reader,
      RawReader::Create(participant,
                        {.topic = client ? reply : request,
                         .type = client ? reply_type : request_type,
                         .reliable = true,
                         .depth = kServiceDepth,
                         .every_partition = false,
                         .ignore_own = false,
                         .user_data = user_data},
                        [writer = endpoints.writer.get(), on_sample = std::move(on_sample)](
                            const RawSample& sample) { on_sample(*writer, sample); }));
  return endpoints;
}

std::optional<WholeServer> FindWholeServer(const ServiceEndpoints& client) {
  const std::vector<Peer> readers = ReadersMatchedBy(*client.writer);
  if (readers.empty()) return std::nullopt;
  const std::vector<Peer> writers = PeersOf(client.reader->entity(), dds_get_matched_publications,
                                            dds_get_matched_publication_data);
  std::optional<WholeServer> found;
  for (const Peer& reader : readers) {
    const bool whole = std::any_of(writers.begin(), writers.end(),
                                   [&](const Peer& writer) { return reader.SameServer(writer); });
    if (!whole || (found.has_value() && reader.IsFastDds())) continue;
    found = WholeServer{.request_reader = reader.endpoint, .fastrtps = reader.IsFastDds()};
    if (!found->fastrtps) break;
  }
  return found;
}

bool MatchesReaderOf(const RawWriter& writer, const ros2::Guid& participant) {
  const std::vector<Peer> readers = ReadersMatchedBy(writer);
  return std::any_of(readers.begin(), readers.end(),
                     [&](const Peer& reader) { return reader.participant == participant; });
}

}  // namespace rips::dds
