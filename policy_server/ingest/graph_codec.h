// The computation graph on the wire.
#ifndef RIPS_POLICY_SERVER_INGEST_GRAPH_CODEC_H_
#define RIPS_POLICY_SERVER_INGEST_GRAPH_CODEC_H_

#include "absl/status/statusor.h"
#include "policy_server/pipeline/inbound.h"
#include "rips/v1/observation.pb.h"
#include "services/ros2/ros_graph.h"

namespace rips::ingest {

// InvalidArgument for a GUID that is not 16 bytes, an unspecified kind, or a version of 0.
// References between the parts are checked by RosGraph::Apply.
absl::StatusOr<ros2::Endpoint> DecodeEndpoint(const rips::v1::Endpoint& endpoint);
absl::StatusOr<pipeline::GraphSnapshotSeen> DecodeSnapshot(const rips::v1::GraphSnapshot& snapshot);
absl::StatusOr<pipeline::GraphDeltaSeen> DecodeDelta(const rips::v1::GraphDelta& delta);

// Everything in `graph`, as settled.
rips::v1::GraphSnapshot EncodeGraph(const ros2::RosGraph& graph);

}  // namespace rips::ingest

#endif  // RIPS_POLICY_SERVER_INGEST_GRAPH_CODEC_H_
