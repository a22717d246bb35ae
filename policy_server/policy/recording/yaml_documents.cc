#include "policy_server/policy/recording/yaml_documents.h"

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/recording/yaml_reader.h"
#include "policy_server/policy/recording/yaml_tree.h"
#include "services/base/status_macros.h"

namespace rips::recording {
namespace {

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

}  // namespace

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

}  // namespace rips::recording
