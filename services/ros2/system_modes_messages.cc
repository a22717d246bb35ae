#include "services/ros2/system_modes_messages.h"

#include <utility>

#include "services/base/status_macros.h"
#include "services/ros2/cdr.h"

namespace rips::ros2 {

std::string EncodeEmptyRequest() {
  CdrWriter writer;
  writer.U8(0);
  return std::move(writer).Finish();
}

std::string EncodeChangeModeRequest(absl::string_view mode) {
  CdrWriter writer;
  writer.String(mode);
  return std::move(writer).Finish();
}

absl::StatusOr<bool> DecodeSuccessReply(absl::string_view payload) {
  CdrReader reader(payload);
  const bool success = reader.Bool();
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return success;
}

absl::StatusOr<std::string> DecodeGetModeReply(absl::string_view payload) {
  CdrReader reader(payload);
  std::string mode(reader.String());
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return mode;
}

absl::StatusOr<std::vector<std::string>> DecodeGetAvailableModesReply(absl::string_view payload) {
  CdrReader reader(payload);
  std::vector<std::string> modes(reader.Count(kCdrStringBytesMin, kModesMax));
  for (std::string& mode : modes) mode = std::string(reader.String());
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return modes;
}

absl::StatusOr<LifecycleLabel> DecodeGetStateReply(absl::string_view payload) {
  CdrReader reader(payload);
  LifecycleLabel label;
  label.id = reader.U8();
  label.label = std::string(reader.String());
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return label;
}

std::string EncodeChangeStateRequest(const LifecycleLabel& transition) {
  CdrWriter writer;
  writer.U8(transition.id);
  writer.String(transition.label);
  return std::move(writer).Finish();
}

}  // namespace rips::ros2
