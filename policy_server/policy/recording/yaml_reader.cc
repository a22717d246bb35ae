#include "policy_server/policy/recording/yaml_reader.h"

#include <optional>
#include <string>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/recording/sequential_reader.h"
#include "policy_server/policy/recording/yaml_context.h"
#include "policy_server/policy/recording/yaml_documents.h"
#include "policy_server/policy/recording/yaml_tree.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::recording {
namespace {

constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;

// A text that must be there.
absl::StatusOr<std::string> TextAt(const YamlNode& event, absl::string_view key) {
  const YamlNode* node = event.Find(key);
  if (node == nullptr) return AtLine(kInvalid, event.line, absl::StrCat("no `", key, "`"));
  if (node->kind != YamlNode::Kind::kScalar || node->text.empty()) {
    return AtLine(kInvalid, node->line, absl::StrCat("`", key, "` is not a text"));
  }
  if (node->text.size() > kNameBytesMax) {
    return AtLine(absl::StatusCode::kResourceExhausted, node->line,
                  absl::StrCat("`", key, "` exceeds the limit of ", kNameBytesMax, " bytes"));
  }
  return node->text;
}

class YamlReader final : public SequentialReader {
 public:
  explicit YamlReader(std::unique_ptr<InputFile> file) : documents_(std::move(file)) {}

  bool has_graph() const override { return true; }

 private:
  absl::StatusOr<std::optional<Recorded>> Read() override {
    absl::StatusOr<std::optional<Recorded>> event = ReadEvent();
    if (!event.ok()) {
      return absl::Status(event.status().code(),
                          absl::StrCat("`", documents_.path(), "`: document ", events_, ": ",
                                       event.status().message()));
    }
    ++events_;
    return event;
  }

  absl::StatusOr<std::optional<Recorded>> ReadEvent() {
    while (true) {
      RIPS_ASSIGN_OR_RETURN(const auto document, documents_.Next());
      if (!document) break;
      RIPS_ASSIGN_OR_RETURN(const YamlNode root, ParseYaml(document->text, document->first_line));
      if (root.kind != YamlNode::Kind::kNull) return Decode(root);
    }
    if (events_ > 0) return std::nullopt;
    return absl::InvalidArgumentError("no event in the whole file");
  }

  absl::StatusOr<Recorded> Decode(const YamlNode& root) {
    if (root.kind != YamlNode::Kind::kMap) {
      return AtLine(kInvalid, root.line, "not an event: a mapping with `event` is expected");
    }
    Recorded recorded;
    RIPS_ASSIGN_OR_RETURN(const std::string kind, TextAt(root, "event"));
    if (const YamlNode* context = root.Find("context"); context != nullptr) {
      RecordedGraph& graph = recorded.context.emplace();
      RIPS_ASSIGN_OR_RETURN(graph.content, contexts_.Decode(*context));
      graph.whole = true;
      graph.settled = true;
    }
    if (kind == "message") {
      RIPS_ASSIGN_OR_RETURN(recorded.what, DecodeMessage(root));
    } else if (kind == "graph") {
      recorded.what = TakeGraph(recorded);
    } else {
      recorded.what = RecordedOther{.what = ros2::Printable(kind)};
    }
    return recorded;
  }

  // Of a graph event the context is the event itself; without one nothing changed.
  static RecordedGraph TakeGraph(Recorded& recorded) {
    RecordedGraph graph{.settled = true};
    if (recorded.context) graph = *std::exchange(recorded.context, std::nullopt);
    return graph;
  }

  absl::StatusOr<RecordedMessage> DecodeMessage(const YamlNode& root) const {
    RIPS_ASSIGN_OR_RETURN(const std::string topic, TextAt(root, "fromtopic"));
    RecordedMessage message{.topic = InRoot(topic)};
    message.type = contexts_.TypeOf(message.topic);
    const YamlNode* raw = root.Find("rawmsg");
    message.truncated = raw == nullptr;
    if (raw == nullptr) return message;
    if (raw->kind != YamlNode::Kind::kScalar ||
        !absl::Base64Unescape(raw->text, &message.payload)) {
      return AtLine(kInvalid, raw->line, "`rawmsg` is not base64");
    }
    message.size_bytes = static_cast<uint32_t>(message.payload.size());
    return message;
  }

  YamlDocuments documents_;
  YamlContexts contexts_;
  uint64_t events_ = 0;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Reader>> OpenYaml(std::unique_ptr<InputFile> file) {
  return std::make_unique<YamlReader>(std::move(file));
}

}  // namespace rips::recording
