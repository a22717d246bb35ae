#include "policy_server/policy/lang/diagnostic/render.h"

#include <algorithm>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

// A longer line is shown around the mistake only.
constexpr int kShownCodePointsMax = 160;
constexpr int kShownBefore = 80;

std::vector<Source> Sources(const std::vector<SourceFile>& files) {
  std::vector<Source> out;
  for (uint32_t i = 0; i < files.size(); ++i) out.emplace_back(i, files[i].text);
  return out;
}

// Code points of `text` that may be printed; a tab stays a tab.
std::vector<char32_t> Printable(absl::string_view text) {
  std::vector<char32_t> out;
  for (size_t offset = 0; offset < text.size();) {
    const CodePoint point = DecodeCodePoint(text, offset);
    const bool hidden = point.value != '\t' && IsControl(point.value);
    out.push_back(hidden ? kReplacementCharacter : point.value);
    offset += point.length;
  }
  return out;
}

std::string PrintableText(absl::string_view text) {
  std::string out;
  for (const char32_t point : Printable(text)) AppendUtf8(point, &out);
  return out;
}

// The line with the mistake and the marks below it.
std::string Excerpt(const Source& source, SourceRange range) {
  const Position begin = source.PositionOf(range.offset);
  const Position end = source.PositionOf(range.offset + range.length);
  const std::vector<char32_t> line = Printable(source.Line(begin.line));
  const int size = static_cast<int>(line.size());
  const int at = std::min(begin.column - 1, size);
  int marks = end.line == begin.line ? end.column - begin.column : size - at;

  const bool windowed = size > kShownCodePointsMax && at > kShownBefore;
  const int shown_begin = windowed ? at - kShownBefore : 0;
  const int shown_end = std::min(size, shown_begin + kShownCodePointsMax);
  marks = std::clamp(marks, 1, std::max(1, shown_end - at));
  std::string text;
  std::string pointer;
  if (shown_begin > 0) text += "...", pointer += "   ";
  for (int i = shown_begin; i < shown_end; ++i) {
    AppendUtf8(line[i], &text);
    if (i < at) pointer.push_back(line[i] == '\t' ? '\t' : ' ');
  }
  if (shown_end < size) text += "...";
  return absl::StrFormat("%5d | %s\n      | %s^%s\n", begin.line, text, pointer,
                         std::string(marks - 1, '~'));
}

std::string JsonString(absl::string_view text) {
  std::string out = "\"";
  for (size_t offset = 0; offset < text.size();) {
    const CodePoint point = DecodeCodePoint(text, offset);
    if (point.value == '"' || point.value == '\\') {
      out.push_back('\\');
      out.push_back(static_cast<char>(point.value));
    } else if (IsControl(point.value)) {
      absl::StrAppendFormat(&out, "\\u%04x", static_cast<uint32_t>(point.value));
    } else {
      AppendUtf8(point.value, &out);
    }
    offset += point.length;
  }
  return out + "\"";
}

std::string JsonDiagnostic(const Source& source, const Diagnostic& diagnostic) {
  const Position position = source.PositionOf(diagnostic.range.offset);
  std::string out =
      absl::StrCat("{\"line\":", position.line, ",\"column\":", position.column, ",\"severity\":\"",
                   Name(SeverityOf(diagnostic.kind)), "\",\"kind\":\"", Name(diagnostic.kind),
                   "\",\"message\":", JsonString(diagnostic.message));
  if (!diagnostic.hint.empty()) absl::StrAppend(&out, ",\"hint\":", JsonString(diagnostic.hint));
  return out + "}";
}

}  // namespace

std::string RenderText(const std::vector<SourceFile>& files,
                       const std::vector<Diagnostic>& diagnostics) {
  const std::vector<Source> sources = Sources(files);
  std::string out;
  for (const Diagnostic& diagnostic : diagnostics) {
    const Source& source = sources.at(diagnostic.range.file);
    const Position position = source.PositionOf(diagnostic.range.offset);
    absl::StrAppend(&out, PrintableText(files[diagnostic.range.file].path), ":", position.line, ":",
                    position.column, ": ", Name(SeverityOf(diagnostic.kind)), ": ",
                    PrintableText(diagnostic.message), "\n", Excerpt(source, diagnostic.range));
    if (!diagnostic.hint.empty()) {
      absl::StrAppend(&out, "      = hint: ", PrintableText(diagnostic.hint), "\n");
    }
  }
  return out;
}

std::string RenderPlaces(const std::vector<SourceFile>& files,
                         const std::vector<Diagnostic>& diagnostics) {
  const std::vector<Source> sources = Sources(files);
  std::string out;
  for (const Diagnostic& diagnostic : diagnostics) {
    const Position position = sources.at(diagnostic.range.file).PositionOf(diagnostic.range.offset);
    absl::StrAppend(&out, PrintableText(files[diagnostic.range.file].path), ":", position.line, ":",
                    position.column, ": ", Name(SeverityOf(diagnostic.kind)), " ",
                    Name(diagnostic.kind), "\n");
  }
  return out;
}

std::string RenderJson(const std::vector<SourceFile>& files,
                       const std::vector<Diagnostic>& diagnostics) {
  const std::vector<Source> sources = Sources(files);
  std::string out = "{\"files\":[";
  for (uint32_t file = 0; file < files.size(); ++file) {
    bool ok = true;
    std::string list;
    for (const Diagnostic& diagnostic : diagnostics) {
      if (diagnostic.range.file != file) continue;
      if (SeverityOf(diagnostic.kind) == DiagnosticSeverity::kError) ok = false;
      absl::StrAppend(&list, list.empty() ? "" : ",", JsonDiagnostic(sources[file], diagnostic));
    }
    absl::StrAppend(&out, file == 0 ? "" : ",", "{\"path\":", JsonString(files[file].path),
                    ",\"ok\":", ok ? "true" : "false", ",\"diagnostics\":[", list, "]}");
  }
  return out + "]}";
}

}  // namespace rips::lang
