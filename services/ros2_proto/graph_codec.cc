#include "services/ros2_proto/graph_codec.h"

#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::ros2_proto {
namespace {

absl::StatusOr<ros2::Participant> DecodeParticipant(const rips::v1::Participant& participant) {
  RIPS_ASSIGN_OR_RETURN(const ros2::Guid guid, ros2::GuidFromBytes(participant.guid()));
  return ros2::Participant{.guid = guid,
                           .host = participant.host(),
                           .enclave = participant.enclave(),
                           .pid = participant.pid(),
                           .vendor = participant.vendor(),
                           .authenticated = participant.authenticated(),
                           .address = participant.address()};
}

absl::StatusOr<ros2::Node> DecodeNode(const rips::v1::Node& node) {
  RIPS_ASSIGN_OR_RETURN(const ros2::Guid guid, ros2::GuidFromBytes(node.participant_guid()));
  return ros2::Node{.full_name = node.full_name(), .participant = guid};
}

constexpr std::pair<ros2::EndpointKind, rips::v1::Endpoint::Kind> kKinds[] = {
    {ros2::EndpointKind::kPublisher, rips::v1::Endpoint::PUBLISHER},
    {ros2::EndpointKind::kSubscriber, rips::v1::Endpoint::SUBSCRIBER},
    {ros2::EndpointKind::kService, rips::v1::Endpoint::SERVICE},
    {ros2::EndpointKind::kClient, rips::v1::Endpoint::CLIENT}};
constexpr std::pair<ros2::Visibility, rips::v1::Visibility> kVisibilities[] = {
    {ros2::Visibility::kWatched, rips::v1::WATCHED},
    {ros2::Visibility::kNotNeeded, rips::v1::NOT_NEEDED},
    {ros2::Visibility::kNotVisible, rips::v1::NOT_VISIBLE}};

absl::StatusOr<ros2::EndpointKind> DecodeKind(rips::v1::Endpoint::Kind kind) {
  for (const auto& [ours, wire] : kKinds) {
    if (wire == kind) return ours;
  }
  return absl::InvalidArgumentError(absl::StrCat("unknown endpoint kind ", static_cast<int>(kind)));
}

rips::v1::Endpoint::Kind EncodeKind(ros2::EndpointKind kind) {
  for (const auto& [ours, wire] : kKinds) {
    if (ours == kind) return wire;
  }
  return rips::v1::Endpoint::KIND_UNSPECIFIED;
}

ros2::Visibility DecodeVisibility(rips::v1::Visibility visibility) {
  for (const auto& [ours, wire] : kVisibilities) {
    if (wire == visibility) return ours;
  }
  return ros2::Visibility::kUnspecified;
}

rips::v1::Visibility EncodeVisibility(ros2::Visibility visibility) {
  for (const auto& [ours, wire] : kVisibilities) {
    if (ours == visibility) return wire;
  }
  return rips::v1::VISIBILITY_UNSPECIFIED;
}

// The three lists of a snapshot, or of what a delta upserts.
template <typename Participants, typename Nodes, typename Endpoints>
absl::Status DecodeUpserts(const Participants& participants, const Nodes& nodes,
                           const Endpoints& endpoints, ros2::GraphDelta* delta) {
  for (const auto& participant : participants) {
    RIPS_ASSIGN_OR_RETURN(delta->upsert_participants.emplace_back(),
                          DecodeParticipant(participant));
  }
  for (const auto& node : nodes) {
    RIPS_ASSIGN_OR_RETURN(delta->upsert_nodes.emplace_back(), DecodeNode(node));
  }
  for (const auto& endpoint : endpoints) {
    RIPS_ASSIGN_OR_RETURN(delta->upsert_endpoints.emplace_back(), DecodeEndpoint(endpoint));
  }
  return absl::OkStatus();
}

absl::StatusOr<ros2::Truncation> DecodeTruncation(const rips::v1::GraphTruncation& wire) {
  ros2::Truncation truncation{.left_out = wire.left_out()};
  if (wire.crowds_size() > static_cast<int>(ros2::Truncation::kCrowdsMax)) {
    return absl::InvalidArgumentError(absl::StrCat(wire.crowds_size(),
                                                   " crowds in a truncation exceed the limit of ",
                                                   ros2::Truncation::kCrowdsMax));
  }
  for (const auto& crowd : wire.crowds()) {
    RIPS_ASSIGN_OR_RETURN(const ros2::Guid guid, ros2::GuidFromBytes(crowd.participant_guid()));
    truncation.crowds.push_back(
        {.participant = guid, .endpoints = crowd.endpoints(), .left_out = crowd.left_out()});
  }
  return truncation;
}

void Encode(const ros2::Truncation& truncation, rips::v1::GraphTruncation& wire) {
  wire.set_left_out(truncation.left_out);
  for (const ros2::Truncation::Crowd& crowd : truncation.crowds) {
    rips::v1::GraphTruncation::Crowd* out = wire.add_crowds();
    out->set_participant_guid(crowd.participant.ToBytes());
    out->set_endpoints(crowd.endpoints);
    out->set_left_out(crowd.left_out);
  }
}

void Encode(const ros2::Participant& participant, rips::v1::Participant& wire) {
  wire.set_guid(participant.guid.ToBytes());
  wire.set_host(participant.host);
  wire.set_enclave(participant.enclave);
  wire.set_pid(participant.pid);
  wire.set_vendor(participant.vendor);
  wire.set_authenticated(participant.authenticated);
  wire.set_address(participant.address);
}

void Encode(const ros2::Node& node, rips::v1::Node& wire) {
  wire.set_full_name(node.full_name);
  wire.set_participant_guid(node.participant.ToBytes());
}

}  // namespace

absl::StatusOr<ros2::Endpoint> DecodeEndpoint(const rips::v1::Endpoint& wire) {
  RIPS_ASSIGN_OR_RETURN(const ros2::Guid guid, ros2::GuidFromBytes(wire.guid()));
  RIPS_ASSIGN_OR_RETURN(const ros2::EndpointKind kind, DecodeKind(wire.kind()));
  return ros2::Endpoint{
      .guid = guid,
      .kind = kind,
      .name = wire.name(),
      .type = wire.type(),
      .node = wire.node(),
      .pending = wire.pending(),
      .qos = {.reliable = wire.qos().reliable(),
              .transient_local = wire.qos().transient_local(),
              .keep_all = wire.qos().keep_all(),
              .depth = wire.qos().depth(),
              .partitions = {wire.qos().partitions().begin(), wire.qos().partitions().end()}},
      .visibility = DecodeVisibility(wire.visibility()),
      .why = wire.why(),
      .ros = wire.ros()};
}

absl::StatusOr<ros2::GraphDelta> DecodeGraph(const rips::v1::GraphSnapshot& wire) {
  ros2::GraphDelta delta;
  RIPS_RETURN_IF_ERROR(DecodeUpserts(wire.participants(), wire.nodes(), wire.endpoints(), &delta));
  if (wire.has_truncation()) {
    RIPS_ASSIGN_OR_RETURN(delta.truncation, DecodeTruncation(wire.truncation()));
  }
  return delta;
}

absl::StatusOr<ros2::GraphDelta> DecodeGraph(const rips::v1::GraphDelta& wire) {
  ros2::GraphDelta delta;
  RIPS_RETURN_IF_ERROR(DecodeUpserts(wire.upsert_participants(), wire.upsert_nodes(),
                                     wire.upsert_endpoints(), &delta));
  for (const std::string& guid : wire.gone_guids()) {
    RIPS_ASSIGN_OR_RETURN(delta.gone_guids.emplace_back(), ros2::GuidFromBytes(guid));
  }
  delta.gone_nodes = {wire.gone_nodes().begin(), wire.gone_nodes().end()};
  if (wire.has_truncation()) {
    RIPS_ASSIGN_OR_RETURN(delta.truncation, DecodeTruncation(wire.truncation()));
  }
  return delta;
}

void EncodeEndpoint(const ros2::Endpoint& endpoint, rips::v1::Endpoint& wire) {
  wire.set_guid(endpoint.guid.ToBytes());
  wire.set_kind(EncodeKind(endpoint.kind));
  wire.set_name(endpoint.name);
  wire.set_type(endpoint.type);
  wire.set_node(endpoint.node);
  wire.set_pending(endpoint.pending);
  rips::v1::Qos* qos = wire.mutable_qos();
  qos->set_reliable(endpoint.qos.reliable);
  qos->set_transient_local(endpoint.qos.transient_local);
  qos->set_keep_all(endpoint.qos.keep_all);
  qos->set_depth(endpoint.qos.depth);
  for (const std::string& partition : endpoint.qos.partitions) qos->add_partitions(partition);
  wire.set_visibility(EncodeVisibility(endpoint.visibility));
  wire.set_why(endpoint.why);
  wire.set_ros(endpoint.ros);
}

void EncodeGraph(const ros2::GraphDelta& delta, rips::v1::GraphSnapshot& wire) {
  for (const auto& each : delta.upsert_participants) Encode(each, *wire.add_participants());
  for (const auto& each : delta.upsert_nodes) Encode(each, *wire.add_nodes());
  for (const auto& each : delta.upsert_endpoints) EncodeEndpoint(each, *wire.add_endpoints());
  if (delta.truncation.has_value()) Encode(*delta.truncation, *wire.mutable_truncation());
}

void EncodeGraph(const ros2::GraphDelta& delta, rips::v1::GraphDelta& wire) {
  for (const auto& each : delta.upsert_participants) Encode(each, *wire.add_upsert_participants());
  for (const auto& each : delta.upsert_nodes) Encode(each, *wire.add_upsert_nodes());
  for (const auto& each : delta.upsert_endpoints) {
    EncodeEndpoint(each, *wire.add_upsert_endpoints());
  }
  for (const ros2::Guid& guid : delta.gone_guids) wire.add_gone_guids(guid.ToBytes());
  for (const std::string& name : delta.gone_nodes) wire.add_gone_nodes(name);
  if (delta.truncation.has_value()) Encode(*delta.truncation, *wire.mutable_truncation());
}

void EncodeGraph(const ros2::RosGraph& graph, rips::v1::GraphSnapshot& wire) {
  for (const auto& [guid, each] : graph.participants()) Encode(each, *wire.add_participants());
  for (const ros2::Node& each : graph.nodes()) Encode(each, *wire.add_nodes());
  for (const auto& [guid, each] : graph.endpoints()) {
    EncodeEndpoint(each, *wire.add_endpoints());
  }
  if (graph.truncated()) Encode(graph.truncation(), *wire.mutable_truncation());
}

}  // namespace rips::ros2_proto
