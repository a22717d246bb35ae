#include "policy_server/policy/recording/rips_writer.h"

#include <unistd.h>

#include <cerrno>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "google/protobuf/descriptor.h"
#include "google/protobuf/message.h"
#include "policy_server/policy/recording/event_codec.h"
#include "policy_server/policy/recording/little_endian.h"
#include "policy_server/policy/recording/reader.h"
#include "policy_server/policy/recording/rips_format.h"
#include "services/base/status_macros.h"
#include "services/text/utf8.h"

namespace rips::recording {
namespace {

absl::Status WriteAll(int fd, absl::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = write(fd, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) {
      const absl::Status status = absl::ErrnoToStatus(errno, "cannot write the recording");
      if (errno == ENOSPC || errno == EDQUOT || errno == EFBIG) {
        return absl::ResourceExhaustedError(status.message());
      }
      return absl::UnavailableError(status.message());
    }
    bytes.remove_prefix(static_cast<size_t>(written));
  }
  return absl::OkStatus();
}

absl::Status CheckGraph(const RecordedGraph& graph) {
  if (!graph.whole || (graph.content.gone_guids.empty() && graph.content.gone_nodes.empty())) {
    return absl::OkStatus();
  }
  return absl::InvalidArgumentError("a whole graph takes something away");
}

absl::Status CheckEvent(const Recorded& event) {
  if (event.context) {
    if (!event.context->whole) {
      return absl::InvalidArgumentError("the graph before an event must be whole");
    }
    RIPS_RETURN_IF_ERROR(CheckGraph(*event.context));
  }
  if (const auto* graph = std::get_if<RecordedGraph>(&event.what)) return CheckGraph(*graph);
  const auto* message = std::get_if<RecordedMessage>(&event.what);
  if (message == nullptr) return absl::OkStatus();
  RIPS_RETURN_IF_ERROR(CheckSize(*message));
  if (message->payload.size() > kMessageBytesMax) {
    return absl::ResourceExhaustedError(absl::StrCat(
        "payload of ", message->payload.size(), " bytes exceeds the limit of ", kMessageBytesMax));
  }
  return absl::OkStatus();
}

// Protobuf would write a text that is not UTF-8, and then refuse to read it.
absl::Status CheckTexts(const google::protobuf::Message& message) {
  using Field = google::protobuf::FieldDescriptor;
  const google::protobuf::Reflection& parts = *message.GetReflection();
  std::vector<const Field*> fields;
  parts.ListFields(message, &fields);
  for (const Field* field : fields) {
    const bool text = field->type() == Field::TYPE_STRING;
    if (!text && field->type() != Field::TYPE_MESSAGE) continue;
    const int count = field->is_repeated() ? parts.FieldSize(message, field) : 1;
    for (int i = 0; i < count; ++i) {
      if (!text) {
        RIPS_RETURN_IF_ERROR(CheckTexts(field->is_repeated()
                                            ? parts.GetRepeatedMessage(message, field, i)
                                            : parts.GetMessage(message, field)));
        continue;
      }
      std::string scratch;
      const std::string& value = field->is_repeated()
                                     ? parts.GetRepeatedStringReference(message, field, i, &scratch)
                                     : parts.GetStringReference(message, field, &scratch);
      if (!FindInvalidUtf8(value)) continue;
      return absl::InvalidArgumentError(absl::StrCat(
          "`", field->name(), "` of `", message.GetDescriptor()->name(), "` is not UTF-8"));
    }
  }
  return absl::OkStatus();
}

// Checked and serialized.
absl::StatusOr<std::string> BodyOf(const google::protobuf::Message& message) {
  const size_t bytes = message.ByteSizeLong();
  if (bytes > kFrameBytesMax) {
    return absl::ResourceExhaustedError(
        absl::StrCat("event of ", bytes, " bytes exceeds the limit of ", kFrameBytesMax));
  }
  RIPS_RETURN_IF_ERROR(CheckTexts(message));
  return message.SerializeAsString();
}

std::string FrameOf(absl::string_view before, absl::string_view body) {
  std::string frame;
  frame.reserve(before.size() + kFrameHeaderBytes + body.size());
  frame.append(before.data(), before.size());
  AppendNumber(body.size(), 4, &frame);
  AppendNumber(Crc32(0, body), 4, &frame);
  frame.append(body.data(), body.size());
  return frame;
}

}  // namespace

absl::StatusOr<std::string> EncodeStart(const RecordedOrigin& origin) {
  RIPS_ASSIGN_OR_RETURN(const std::string body, BodyOf(EncodeHeader(origin)));
  return FrameOf(kRipsMagic, body);
}

absl::StatusOr<std::string> EncodeFrame(const Recorded& event) {
  RIPS_RETURN_IF_ERROR(CheckEvent(event));
  RIPS_ASSIGN_OR_RETURN(const std::string body, BodyOf(EncodeEvent(event)));
  return FrameOf({}, body);
}

absl::Status RipsWriter::Write(absl::string_view bytes) {
  broken_ = WriteAll(fd_, bytes);
  return broken_;
}

absl::StatusOr<RipsWriter> RipsWriter::Create(int fd, const RecordedOrigin& origin) {
  RIPS_ASSIGN_OR_RETURN(const std::string start, EncodeStart(origin));
  RipsWriter writer(fd);
  RIPS_RETURN_IF_ERROR(writer.Write(start));
  return writer;
}

absl::Status RipsWriter::Append(const Recorded& event) {
  RIPS_RETURN_IF_ERROR(broken_);
  RIPS_ASSIGN_OR_RETURN(const std::string frame, EncodeFrame(event));
  return Write(frame);
}

}  // namespace rips::recording
