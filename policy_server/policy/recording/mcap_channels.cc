#include "policy_server/policy/recording/mcap_channels.h"

#include <limits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/recording/little_endian.h"
#include "policy_server/policy/recording/reader.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::recording {
namespace {

absl::Status CheckName(absl::string_view what, absl::string_view name) {
  if (name.size() <= kNameBytesMax) return absl::OkStatus();
  return absl::ResourceExhaustedError(
      absl::StrCat(what, " name of ", name.size(), " bytes exceeds the limit of ", kNameBytesMax));
}

}  // namespace

absl::Status McapChannels::AddSchema(absl::string_view content) {
  Cursor cursor(content);
  const uint16_t id = cursor.U16();
  const absl::string_view name = cursor.Text();
  cursor.Text();  // how the definition is written
  cursor.Text();  // the definition
  if (!cursor.ok()) return absl::DataLossError("a schema is cut");
  if (id == 0) return absl::DataLossError("a schema has the id 0");
  RIPS_RETURN_IF_ERROR(CheckName("schema", name));
  const auto [at, added] = schemas_.try_emplace(id, name);
  if (!added && at->second != name) {
    return absl::DataLossError(absl::StrCat("schema ", id, " is defined twice, differently"));
  }
  return absl::OkStatus();
}

absl::Status McapChannels::AddChannel(absl::string_view content) {
  Cursor cursor(content);
  const uint16_t id = cursor.U16();
  Channel channel{.schema = cursor.U16()};
  const absl::string_view topic = cursor.Text();
  const absl::string_view encoding = cursor.Text();
  cursor.Text();  // metadata
  if (!cursor.ok()) return absl::DataLossError("a channel is cut");
  RIPS_RETURN_IF_ERROR(CheckName("topic", topic));
  channel.topic = std::string(topic);
  if (encoding != "cdr") {
    return absl::InvalidArgumentError(absl::StrCat("topic `", ros2::Printable(topic),
                                                   "` is encoded as `", ros2::Printable(encoding),
                                                   "`; only `cdr` can be replayed"));
  }
  if (channel.schema != 0) {
    const auto schema = schemas_.find(channel.schema);
    if (schema == schemas_.end()) {
      return absl::DataLossError(
          absl::StrCat("channel ", id, " has schema ", channel.schema, ", which is not defined"));
    }
    channel.type = schema->second;
  }
  const auto [at, added] = channels_.try_emplace(id, channel);
  if (!added && at->second != channel) {
    return absl::DataLossError(absl::StrCat("channel ", id, " is defined twice, differently"));
  }
  return absl::OkStatus();
}

absl::StatusOr<McapMessage> McapChannels::Parse(absl::string_view content) const {
  Cursor cursor(content);
  McapMessage message{.channel = cursor.U16()};
  cursor.U32();  // sequence
  const uint64_t log_time = cursor.U64();
  cursor.U64();  // publish time
  if (!cursor.ok()) return absl::DataLossError("a message is cut");
  message.payload = cursor.rest();
  if (!channels_.contains(message.channel)) {
    return absl::DataLossError(
        absl::StrCat("a message is on channel ", message.channel, ", which is not defined"));
  }
  if (log_time > static_cast<uint64_t>(std::numeric_limits<int64_t>::max())) {
    return absl::DataLossError(absl::StrCat("a message has the time ", log_time));
  }
  if (message.payload.size() > kMessageBytesMax) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "message of ", message.payload.size(), " bytes exceeds the limit of ", kMessageBytesMax));
  }
  message.log_time_ns = static_cast<int64_t>(log_time);
  return message;
}

Recorded McapChannels::Resolve(const McapMessage& message) const {
  const Channel& channel = channels_.at(message.channel);
  return {.time_unix_ns = message.log_time_ns,
          .what = RecordedMessage{.topic = channel.topic,
                                  .type = channel.type,
                                  .payload = std::string(message.payload),
                                  .size_bytes = static_cast<uint32_t>(message.payload.size())}};
}

}  // namespace rips::recording
