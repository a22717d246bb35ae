#include "policy_server/policy/recording/yaml_reader.h"

#include <optional>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/recording/yaml_context.h"
#include "policy_server/policy/recording/yaml_tree.h"
#include "services/base/status_macros.h"
#include "services/ros2/ros_name.h"

namespace rips::recording {
namespace {

constexpr auto kInvalid = absl::StatusCode::kInvalidArgument;

struct YamlDocument {
  // With its `---` line, if it has one.
  std::string text;
  // 1-based.
  uint64_t first_line = 0;
};

// Cuts a YAML stream into its documents.
class YamlDocuments {
 public:
  explicit YamlDocuments(std::unique_ptr<InputFile> file) : file_(std::move(file)) {}

  // The next document that holds more than comments; nullopt at the end. DataLoss: the last one is
  // cut: not ended, after one that was ended by `...`, or in the middle of a line. InvalidArgument:
  // a byte 0. ResourceExhausted: longer than kYamlDocumentBytesMax. Messages start with the line.
  absl::StatusOr<std::optional<YamlDocument>> Next();

  const std::string& path() const { return file_->path(); }

 private:
  // False at the end.
  absl::StatusOr<bool> NextLine();
  absl::StatusOr<std::optional<YamlDocument>> Finish(YamlDocument document) const;

  const std::unique_ptr<InputFile> file_;
  uint64_t line_number_ = 0;
  std::string line_;
  // line_ starts the next document.
  bool held_ = false;
  bool ended_by_dots_ = false;
};

constexpr absl::string_view kByteOrderMark("\xef\xbb\xbf", 3);

// `marker` alone, or followed by white space (YAML 1.2.2, 9.1.2).
bool IsMarker(absl::string_view line, absl::string_view marker) {
  if (!absl::StartsWith(line, marker)) return false;
  line.remove_prefix(marker.size());
  return line.empty() || absl::ascii_isspace(static_cast<unsigned char>(line[0]));
}

bool IsBlank(absl::string_view text) {
  text = absl::StripAsciiWhitespace(text);
  return text.empty() || text[0] == '#';
}

absl::StatusOr<bool> YamlDocuments::NextLine() {
  if (held_) {
    held_ = false;
    return true;
  }
  RIPS_ASSIGN_OR_RETURN(const bool more, file_->ReadLine(kYamlDocumentBytesMax, &line_));
  if (!more) return false;
  if (++line_number_ == 1 && absl::StartsWith(line_, kByteOrderMark)) {
    line_.erase(0, kByteOrderMark.size());
  }
  if (line_.find('\0') == std::string::npos) return true;
  return AtLine(absl::StatusCode::kInvalidArgument, line_number_,
                "a byte 0: not a recording that is known here");
}

absl::StatusOr<std::optional<YamlDocument>> YamlDocuments::Next() {
  YamlDocument document;
  bool has_content = false;
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool more, NextLine());
    if (!more) break;
    const bool starts = IsMarker(line_, "---");
    const bool ends = IsMarker(line_, "...");
    ended_by_dots_ = ended_by_dots_ || ends;
    if (has_content && (starts || ends)) {
      held_ = starts;
      return document;
    }
    if (ends || starts || document.text.empty()) {
      document = {.first_line = line_number_};
    }
    if (ends) continue;
    document.text.append(line_);
    if (document.text.size() > kYamlDocumentBytesMax) {
      return AtLine(
          absl::StatusCode::kResourceExhausted, line_number_,
          absl::StrCat("a document exceeds the limit of ", kYamlDocumentBytesMax, " bytes"));
    }
    const absl::string_view content = absl::string_view(line_).substr(starts ? 3 : 0);
    // Directives stand before the first marker.
    const bool directive = !has_content && absl::StartsWith(line_, "%");
    has_content = has_content || !(IsBlank(content) || directive);
  }
  if (!has_content) return std::nullopt;
  return Finish(std::move(document));
}

absl::StatusOr<std::optional<YamlDocument>> YamlDocuments::Finish(YamlDocument document) const {
  if (ended_by_dots_ || !absl::EndsWith(document.text, "\n")) {
    return AtLine(absl::StatusCode::kDataLoss, line_number_,
                  "the file is cut within a document; its end is a line `...`");
  }
  return document;
}

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

class YamlReader final : public Reader {
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
