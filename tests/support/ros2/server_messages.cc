#include "tests/support/ros2/server_messages.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/ros2/cdr.h"

namespace rips::ros2 {

// Requests and replies with the same members have the same bytes.
absl::Status DecodeEmptyRequest(absl::string_view payload) {
  CdrReader reader(payload);
  reader.U8();
  return reader.Finish();
}

absl::StatusOr<std::string> DecodeChangeModeRequest(absl::string_view payload) {
  return DecodeGetModeReply(payload);
}

std::string EncodeSuccessReply(bool success) {
  CdrWriter writer;
  writer.Bool(success);
  return std::move(writer).Finish();
}

std::string EncodeGetModeReply(absl::string_view mode) { return EncodeChangeModeRequest(mode); }

std::string EncodeGetAvailableModesReply(const std::vector<std::string>& modes) {
  return EncodeGetParametersRequest(modes);
}

std::string EncodeGetStateReply(const LifecycleLabel& state) {
  return EncodeChangeStateRequest(state);
}

absl::StatusOr<LifecycleLabel> DecodeChangeStateRequest(absl::string_view payload) {
  return DecodeGetStateReply(payload);
}

absl::StatusOr<std::vector<std::string>> DecodeGetParametersRequest(absl::string_view payload) {
  CdrReader reader(payload);
  std::vector<std::string> names(reader.Count(kCdrStringBytesMin, kParametersMax));
  for (std::string& name : names) name = std::string(reader.String());
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return names;
}

std::string EncodeGetParametersReply(const std::vector<ParameterValue>& values) {
  CdrWriter writer;
  writer.U32(static_cast<uint32_t>(values.size()));
  for (const ParameterValue& value : values) WriteParameterValue(value, writer);
  return std::move(writer).Finish();
}

absl::StatusOr<std::vector<NamedParameter>> DecodeSetParametersRequest(absl::string_view payload) {
  CdrReader reader(payload);
  std::vector<NamedParameter> parameters;
  const uint32_t count = reader.Count(kCdrStringBytesMin + kParameterValueBytesMin, kParametersMax);
  for (uint32_t i = 0; i < count && reader.ok(); ++i) {
    std::string name(reader.String());
    parameters.push_back({std::move(name), ReadParameterValue(reader)});
  }
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return parameters;
}

std::string EncodeSetParametersReply(const SetParametersResult& result) {
  CdrWriter writer;
  writer.Bool(result.successful);
  writer.String(result.reason);
  return std::move(writer).Finish();
}

absl::Status CheckOrigin(const ParticipantEntities& info, const Guid& writer) {
  if (info.participant != writer.Participant()) {
    return absl::PermissionDeniedError(absl::StrCat(
        "endpoint ", ToString(writer), " speaks for participant ", ToString(info.participant)));
  }
  for (const NodeEntities& node : info.nodes) {
    for (const std::vector<Guid>* gids : {&node.readers, &node.writers}) {
      for (const Guid& gid : *gids) {
        if (gid.SamePrefix(writer)) continue;
        return absl::PermissionDeniedError(absl::StrCat("endpoint ", ToString(writer),
                                                        " claims endpoint ", ToString(gid),
                                                        " of another participant"));
      }
    }
  }
  return absl::OkStatus();
}

}  // namespace rips::ros2
