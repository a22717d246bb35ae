// Whatever bytes a participant sends as discovery info, service message or name: nothing crashes,
// and what decodes survives encoding and decoding again.
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "services/base/check.h"
#include "services/ros2/cdr.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/ros_graph.h"
#include "services/ros2/ros_name.h"
#include "services/ros2/service_header.h"
#include "tests/support/ros2/server_messages.h"

namespace rips::ros2 {
namespace {

// Values are compared as they are encoded, since a NaN does not equal itself.
template <typename Decode, typename Encode>
void RoundTrip(absl::string_view payload, Decode decode, Encode encode) {
  const auto value = decode(payload);
  if (!value.ok()) return;
  const std::string encoded = encode(*value);
  const auto again = decode(encoded);
  RIPS_CHECK(again.ok(), "what was encoded does not decode");
  RIPS_CHECK(encode(*again) == encoded, "a value changed on its way");
}

void Messages(absl::string_view payload) {
  RoundTrip(
      payload, [](absl::string_view p) { return DecodeParticipantEntities(p); },
      EncodeParticipantEntities);
  RoundTrip(payload, DecodeChangeModeRequest, EncodeChangeModeRequest);
  RoundTrip(payload, DecodeSuccessReply, EncodeSuccessReply);
  RoundTrip(payload, DecodeGetModeReply, EncodeGetModeReply);
  RoundTrip(payload, DecodeGetAvailableModesReply, EncodeGetAvailableModesReply);
  RoundTrip(payload, DecodeGetStateReply, EncodeGetStateReply);
  RoundTrip(payload, DecodeChangeStateRequest, EncodeChangeStateRequest);
  RoundTrip(payload, DecodeGetParametersRequest, EncodeGetParametersRequest);
  RoundTrip(payload, DecodeGetParametersReply, EncodeGetParametersReply);
  if (DecodeEmptyRequest(payload).ok()) {
    RIPS_CHECK(payload.size() <= 8, "an empty request of many bytes");
  }
  const auto values = DecodeGetParametersReply(payload);
  if (!values.ok()) return;
  for (const ParameterValue& value : *values) ToString(value);
}

void Service(absl::string_view payload) {
  const auto message = SplitServiceHeader(payload);
  if (!message.ok()) return;
  const auto joined = AddServiceHeader(message->payload, message->header);
  RIPS_CHECK(joined.ok(), "a split message does not join");
  // The writer leaves the option bytes 0 and pads the end.
  RIPS_CHECK(absl::string_view(*joined).substr(kCdrHeaderBytes, payload.size() - kCdrHeaderBytes) ==
                 payload.substr(kCdrHeaderBytes),
             "a split message joins to something else");
  Messages(message->payload);
}

void Origin(absl::string_view payload) {
  const auto info = DecodeParticipantEntities(payload);
  if (!info.ok() || !CheckOrigin(*info, info->participant).ok()) return;
  // What passed both checks is fit for a graph.
  GraphDelta delta;
  delta.upsert_participants.push_back({.guid = info->participant});
  for (const NodeEntities& node : info->nodes) {
    delta.upsert_nodes.push_back(
        {JoinNodeName(node.node_namespace, node.node_name), info->participant});
  }
  RosGraph graph;
  RIPS_CHECK(graph.Apply(delta).ok(), "a decoded node is refused by the graph");
}

void Names(absl::string_view text) {
  const DemangledTopic topic = DemangleTopic(text);
  RIPS_CHECK(Printable(text).size() <= kPrintableBytesMax, "a printable text is too long");
  switch (topic.kind) {
    case DdsTopicKind::kTopic:
      RIPS_CHECK(MangleTopic(topic.name) == text, "a topic name changed");
      break;
    case DdsTopicKind::kServiceRequest:
      RIPS_CHECK(MangleServiceRequest(topic.name) == text, "a request name changed");
      break;
    case DdsTopicKind::kServiceReply:
      RIPS_CHECK(MangleServiceReply(topic.name) == text, "a reply name changed");
      break;
    case DdsTopicKind::kOther:
      return;
  }
  RIPS_CHECK(ValidateTopicName(topic.name).ok(), "a demangled name is not valid");
  RIPS_CHECK(!DemangleType(text).empty(), "a type vanished");
}

}  // namespace
}  // namespace rips::ros2

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  // A copy of exactly that size, so that a read past its end is seen.
  const std::vector<char> bytes(data, data + size);
  const absl::string_view input(bytes.data(), bytes.size());
  rips::ros2::Messages(input);
  rips::ros2::Service(input);
  rips::ros2::Origin(input);
  rips::ros2::Names(input);
  return 0;
}
