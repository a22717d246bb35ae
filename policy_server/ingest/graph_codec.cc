#include "policy_server/ingest/graph_codec.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

namespace rips::ingest {
namespace {

absl::StatusOr<ros2::Participant> DecodeParticipant(const rips::v1::Participant& participant) {
  RIPS_ASSIGN_OR_RETURN(const ros2::Guid guid, ros2::GuidFromBytes(participant.guid()));
  return ros2::Participant{.guid = guid,
                           .host = participant.host(),
                           .enclave = participant.enclave(),
                           .pid = participant.pid(),
                           .vendor = participant.vendor(),
                           .authenticated = participant.authenticated()};
}

absl::StatusOr<ros2::Node> DecodeNode(const rips::v1::Node& node) {
  RIPS_ASSIGN_OR_RETURN(const ros2::Guid guid, ros2::GuidFromBytes(node.participant_guid()));
  return ros2::Node{.full_name = node.full_name(), .participant = guid};
}

absl::StatusOr<ros2::EndpointKind> DecodeKind(rips::v1::Endpoint::Kind kind) {
  switch (kind) {
    case rips::v1::Endpoint::PUBLISHER:
      return ros2::EndpointKind::kPublisher;
    case rips::v1::Endpoint::SUBSCRIBER:
      return ros2::EndpointKind::kSubscriber;
    case rips::v1::Endpoint::SERVICE:
      return ros2::EndpointKind::kService;
    case rips::v1::Endpoint::CLIENT:
      return ros2::EndpointKind::kClient;
    default:
      return absl::InvalidArgumentError(
          absl::StrCat("unknown endpoint kind ", static_cast<int>(kind)));
  }
}

rips::v1::Endpoint::Kind EncodeKind(ros2::EndpointKind kind) {
  switch (kind) {
    case ros2::EndpointKind::kPublisher:
      return rips::v1::Endpoint::PUBLISHER;
    case ros2::EndpointKind::kSubscriber:
      return rips::v1::Endpoint::SUBSCRIBER;
    case ros2::EndpointKind::kService:
      return rips::v1::Endpoint::SERVICE;
    case ros2::EndpointKind::kClient:
      return rips::v1::Endpoint::CLIENT;
  }
  return rips::v1::Endpoint::KIND_UNSPECIFIED;
}

ros2::Visibility DecodeVisibility(rips::v1::Visibility visibility) {
  switch (visibility) {
    case rips::v1::WATCHED:
      return ros2::Visibility::kWatched;
    case rips::v1::NOT_NEEDED:
      return ros2::Visibility::kNotNeeded;
    case rips::v1::NOT_VISIBLE:
      return ros2::Visibility::kNotVisible;
    default:
      return ros2::Visibility::kUnspecified;
  }
}

rips::v1::Visibility EncodeVisibility(ros2::Visibility visibility) {
  switch (visibility) {
    case ros2::Visibility::kWatched:
      return rips::v1::WATCHED;
    case ros2::Visibility::kNotNeeded:
      return rips::v1::NOT_NEEDED;
    case ros2::Visibility::kNotVisible:
      return rips::v1::NOT_VISIBLE;
    case ros2::Visibility::kUnspecified:
      break;
  }
  return rips::v1::VISIBILITY_UNSPECIFIED;
}

// `Message` is a snapshot or the upserts of a delta, by its three lists.
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

}  // namespace

absl::StatusOr<ros2::Endpoint> DecodeEndpoint(const rips::v1::Endpoint& endpoint) {
  RIPS_ASSIGN_OR_RETURN(const ros2::Guid guid, ros2::GuidFromBytes(endpoint.guid()));
  RIPS_ASSIGN_OR_RETURN(const ros2::EndpointKind kind, DecodeKind(endpoint.kind()));
  return ros2::Endpoint{.guid = guid,
                        .kind = kind,
                        .name = endpoint.name(),
                        .type = endpoint.type(),
                        .node = endpoint.node(),
                        .pending = endpoint.pending(),
                        .qos = {.reliable = endpoint.qos().reliable(),
                                .transient_local = endpoint.qos().transient_local(),
                                .keep_all = endpoint.qos().keep_all(),
                                .depth = endpoint.qos().depth(),
                                .partitions = {endpoint.qos().partitions().begin(),
                                               endpoint.qos().partitions().end()}},
                        .visibility = DecodeVisibility(endpoint.visibility()),
                        .why = endpoint.why(),
                        .ros = endpoint.ros()};
}

absl::StatusOr<pipeline::GraphSnapshotSeen> DecodeSnapshot(
    const rips::v1::GraphSnapshot& snapshot) {
  if (snapshot.graph_version() == 0) {
    return absl::InvalidArgumentError("graph versions count from 1");
  }
  pipeline::GraphSnapshotSeen seen{.version = snapshot.graph_version(),
                                   .settled = snapshot.settled()};
  RIPS_RETURN_IF_ERROR(DecodeUpserts(snapshot.participants(), snapshot.nodes(),
                                     snapshot.endpoints(), &seen.content));
  return seen;
}

absl::StatusOr<pipeline::GraphDeltaSeen> DecodeDelta(const rips::v1::GraphDelta& delta) {
  if (delta.to_version() <= delta.from_version()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "graph delta from version ", delta.from_version(), " to ", delta.to_version()));
  }
  pipeline::GraphDeltaSeen seen{.from_version = delta.from_version(),
                                .to_version = delta.to_version(),
                                .settled = delta.settled()};
  RIPS_RETURN_IF_ERROR(DecodeUpserts(delta.upsert_participants(), delta.upsert_nodes(),
                                     delta.upsert_endpoints(), &seen.delta));
  for (const std::string& guid : delta.gone_guids()) {
    RIPS_ASSIGN_OR_RETURN(seen.delta.gone_guids.emplace_back(), ros2::GuidFromBytes(guid));
  }
  seen.delta.gone_nodes = {delta.gone_nodes().begin(), delta.gone_nodes().end()};
  return seen;
}

rips::v1::GraphSnapshot EncodeGraph(const ros2::RosGraph& graph) {
  rips::v1::GraphSnapshot snapshot;
  snapshot.set_settled(true);
  for (const auto& [guid, participant] : graph.participants()) {
    rips::v1::Participant* out = snapshot.add_participants();
    out->set_guid(guid.ToBytes());
    out->set_host(participant.host);
    out->set_enclave(participant.enclave);
    out->set_pid(participant.pid);
    out->set_vendor(participant.vendor);
    out->set_authenticated(participant.authenticated);
  }
  for (const ros2::Node& node : graph.nodes()) {
    rips::v1::Node* out = snapshot.add_nodes();
    out->set_full_name(node.full_name);
    out->set_participant_guid(node.participant.ToBytes());
  }
  for (const auto& [guid, endpoint] : graph.endpoints()) {
    rips::v1::Endpoint* out = snapshot.add_endpoints();
    out->set_guid(guid.ToBytes());
    out->set_kind(EncodeKind(endpoint.kind));
    out->set_name(endpoint.name);
    out->set_type(endpoint.type);
    out->set_node(endpoint.node);
    out->set_pending(endpoint.pending);
    out->mutable_qos()->set_reliable(endpoint.qos.reliable);
    out->mutable_qos()->set_transient_local(endpoint.qos.transient_local);
    out->mutable_qos()->set_keep_all(endpoint.qos.keep_all);
    out->mutable_qos()->set_depth(endpoint.qos.depth);
    for (const std::string& partition : endpoint.qos.partitions) {
      out->mutable_qos()->add_partitions(partition);
    }
    out->set_visibility(EncodeVisibility(endpoint.visibility));
    out->set_why(endpoint.why);
    out->set_ros(endpoint.ros);
  }
  return snapshot;
}

}  // namespace rips::ingest
