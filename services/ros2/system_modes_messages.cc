#include "services/ros2/system_modes_messages.h"

#include <utility>

#include "services/base/status_macros.h"
#include "services/ros2/cdr.h"

namespace rips::ros2 {
namespace {

// Smallest string on the wire: its length.
constexpr size_t kStringBytesMin = 4;

std::string EncodeString(absl::string_view text) {
  CdrWriter writer;
  writer.String(text);
  return std::move(writer).Finish();
}

absl::StatusOr<std::string> DecodeString(absl::string_view payload) {
  CdrReader reader(payload);
  std::string text(reader.String());
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return text;
}

std::string EncodeLabel(const LifecycleLabel& label) {
  CdrWriter writer;
  writer.U8(label.id);
  writer.String(label.label);
  return std::move(writer).Finish();
}

absl::StatusOr<LifecycleLabel> DecodeLabel(absl::string_view payload) {
  CdrReader reader(payload);
  LifecycleLabel label;
  label.id = reader.U8();
  label.label = std::string(reader.String());
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return label;
}

}  // namespace

std::string EncodeEmptyRequest() {
  CdrWriter writer;
  writer.U8(0);
  return std::move(writer).Finish();
}

absl::Status DecodeEmptyRequest(absl::string_view payload) {
  CdrReader reader(payload);
  reader.U8();
  return reader.Finish();
}

std::string EncodeChangeModeRequest(absl::string_view mode) { return EncodeString(mode); }
absl::StatusOr<std::string> DecodeChangeModeRequest(absl::string_view payload) {
  return DecodeString(payload);
}

std::string EncodeSuccessReply(bool success) {
  CdrWriter writer;
  writer.Bool(success);
  return std::move(writer).Finish();
}

absl::StatusOr<bool> DecodeSuccessReply(absl::string_view payload) {
  CdrReader reader(payload);
  const bool success = reader.Bool();
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return success;
}

std::string EncodeGetModeReply(absl::string_view mode) { return EncodeString(mode); }
absl::StatusOr<std::string> DecodeGetModeReply(absl::string_view payload) {
  return DecodeString(payload);
}

std::string EncodeGetAvailableModesReply(const std::vector<std::string>& modes) {
  CdrWriter writer;
  writer.U32(static_cast<uint32_t>(modes.size()));
  for (const std::string& mode : modes) writer.String(mode);
  return std::move(writer).Finish();
}

absl::StatusOr<std::vector<std::string>> DecodeGetAvailableModesReply(absl::string_view payload) {
  CdrReader reader(payload);
  std::vector<std::string> modes(reader.Count(kStringBytesMin, kModesMax));
  for (std::string& mode : modes) mode = std::string(reader.String());
  RIPS_RETURN_IF_ERROR(reader.Finish());
  return modes;
}

std::string EncodeGetStateReply(const LifecycleLabel& state) { return EncodeLabel(state); }
absl::StatusOr<LifecycleLabel> DecodeGetStateReply(absl::string_view payload) {
  return DecodeLabel(payload);
}
std::string EncodeChangeStateRequest(const LifecycleLabel& transition) {
  return EncodeLabel(transition);
}
absl::StatusOr<LifecycleLabel> DecodeChangeStateRequest(absl::string_view payload) {
  return DecodeLabel(payload);
}

}  // namespace rips::ros2
