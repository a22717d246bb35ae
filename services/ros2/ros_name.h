// How ROS 2 names stand in DDS and back (ROS design article "Topic and Service name mapping to
// DDS"; the same for every RMW on DDS).
//
//   ROS                  DDS topic                DDS type
//   topic /a/b           rt/a/b                   pkg::msg::dds_::T_
//   service /s, request  rq/sRequest              pkg::srv::dds_::T_Request_
//   service /s, reply    rr/sReply                pkg::srv::dds_::T_Response_
//   action /x            the above, at
//   /x/_action/{send_goal,get_result,cancel_goal,feedback,status}
#ifndef RIPS_SERVICES_ROS2_ROS_NAME_H_
#define RIPS_SERVICES_ROS2_ROS_NAME_H_

#include <cstddef>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "services/ros2/ros_graph.h"

namespace rips::ros2 {

// DDS name of the topic on which every participant announces its nodes, and its type.
inline constexpr char kDiscoveryTopic[] = "ros_discovery_info";
inline constexpr char kDiscoveryType[] = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_";

// Longest ROS topic, service or node name accepted, in bytes.
inline constexpr size_t kRosNameBytesMax = 255;
// Longest name of anything else (DDS topic, type, host, enclave) after escaping, in bytes.
inline constexpr size_t kPrintableBytesMax = 512;

enum class DdsTopicKind {
  kTopic,           // rt/
  kServiceRequest,  // rq/...Request
  kServiceReply,    // rr/...Reply
  kOther,           // not a ROS name, ros_discovery_info included
};

struct DemangledTopic {
  DdsTopicKind kind = DdsTopicKind::kOther;
  // With leading slash. For kOther Printable(the DDS name).
  std::string name;

  friend bool operator==(const DemangledTopic&, const DemangledTopic&) = default;
};

// Never fails: a prefix whose rest is no valid ROS name is kOther.
DemangledTopic DemangleTopic(absl::string_view dds_topic);

// "std_msgs::msg::dds_::String_" -> "std_msgs/msg/String";
// "std_srvs::srv::dds_::SetBool_Request_" -> "std_srvs/srv/SetBool". Any other: Printable().
std::string DemangleType(absl::string_view dds_type);

// What an endpoint is, seen from ROS. Every service is two endpoints on the server (request
// reader, reply writer) and two on the client.
//
//                     writer        reader
//   kTopic, kOther    kPublisher    kSubscriber
//   kServiceRequest   kClient       kService
//   kServiceReply     kService      kClient
EndpointKind KindOf(DdsTopicKind kind, bool writer);

// `name` must be valid (ValidateTopicName), `type` of the form "pkg/msg/T" or "pkg/srv/T".
std::string MangleTopic(absl::string_view name);               // rt/...
std::string MangleServiceRequest(absl::string_view name);      // rq/...Request
std::string MangleServiceReply(absl::string_view name);        // rr/...Reply
std::string MangleType(absl::string_view type);                // pkg::msg::dds_::T_
std::string MangleServiceRequestType(absl::string_view type);  // pkg::srv::dds_::T_Request_
std::string MangleServiceReplyType(absl::string_view type);    // pkg::srv::dds_::T_Response_

// InvalidArgument unless fully qualified: "/tok/tok", tokens [A-Za-z_][A-Za-z0-9_]*, at most
// kRosNameBytesMax bytes. For topics, services and full node names alike.
absl::Status ValidateTopicName(absl::string_view name);
absl::Status ValidateNodeName(absl::string_view full_name);

// "/" + "n" -> "/n", "/ns" + "n" -> "/ns/n".
std::string JoinNodeName(absl::string_view node_namespace, absl::string_view node_name);

// `text` with every byte outside printable ASCII, and the backslash, as \xNN, cut to
// kPrintableBytesMax with "..." at the end. Untrusted text becomes safe to log and to put
// into a protobuf string.
std::string Printable(absl::string_view text);

}  // namespace rips::ros2

#endif  // RIPS_SERVICES_ROS2_ROS_NAME_H_
