// The computation graph between ros2 and rips.v1, both ways: sensor, server and recordings share
// it. Graph versions are the caller's business; so is `settled`.
#ifndef RIPS_SERVICES_ROS2_PROTO_GRAPH_CODEC_H_
#define RIPS_SERVICES_ROS2_PROTO_GRAPH_CODEC_H_

#include "absl/status/statusor.h"
#include "rips/v1/observation.pb.h"
#include "services/ros2/ros_graph.h"

namespace rips::ros2_proto {

// InvalidArgument for a GUID that is not 16 bytes, an unspecified kind, or too many crowds.
// References between the parts are checked by RosGraph::Apply.
absl::StatusOr<ros2::Endpoint> DecodeEndpoint(const rips::v1::Endpoint& wire);
// Of a snapshot only upserts.
absl::StatusOr<ros2::GraphDelta> DecodeGraph(const rips::v1::GraphSnapshot& wire);
absl::StatusOr<ros2::GraphDelta> DecodeGraph(const rips::v1::GraphDelta& wire);

// Sets every field of the empty `wire`; into a snapshot the upserts and the truncation alone.
void EncodeEndpoint(const ros2::Endpoint& endpoint, rips::v1::Endpoint& wire);
void EncodeGraph(const ros2::GraphDelta& delta, rips::v1::GraphSnapshot& wire);
void EncodeGraph(const ros2::GraphDelta& delta, rips::v1::GraphDelta& wire);
// Everything in `graph`.
void EncodeGraph(const ros2::RosGraph& graph, rips::v1::GraphSnapshot& wire);

}  // namespace rips::ros2_proto

#endif  // RIPS_SERVICES_ROS2_PROTO_GRAPH_CODEC_H_
