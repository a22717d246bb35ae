#include "services/runtime/log.h"

#include <atomic>
#include <string>

#include "absl/strings/str_format.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/log_writer.h"
#include "services/text/utf8.h"

namespace rips {
namespace {

// The one mutable global: a log level belongs to the process.
std::atomic<LogLevel> g_level{LogLevel::kInfo};

// Characters that could forge a line or reorder it on a terminal.
bool MayForge(char32_t value) {
  return IsControl(value) || value == 0x200e || value == 0x200f ||
         (value >= 0x2028 && value <= 0x202e) || (value >= 0x2066 && value <= 0x2069);
}

void AppendEscaped(absl::string_view bytes, std::string* out) {
  if (bytes == "\n") {
    absl::StrAppend(out, "\\n");
  } else if (bytes == "\t") {
    absl::StrAppend(out, "\\t");
  } else {
    for (const char c : bytes) absl::StrAppendFormat(out, "\\x%02x", static_cast<unsigned char>(c));
  }
}

void AppendValue(absl::string_view value, std::string* out) {
  const bool cut = value.size() > kLogValueBytesMax;
  if (cut) value = value.substr(0, kLogValueBytesMax);
  std::string text;
  bool quoted = value.empty() || cut;
  for (size_t i = 0; i < value.size();) {
    const CodePoint point = DecodeCodePoint(value, i);
    const absl::string_view bytes = value.substr(i, point.length);
    if (!point.valid || MayForge(point.value)) {
      quoted = true;
      AppendEscaped(bytes, &text);
    } else if (point.value == '"' || point.value == '\\') {
      quoted = true;
      absl::StrAppend(&text, "\\", bytes);
    } else {
      quoted = quoted || point.value == ' ' || point.value == '=';
      absl::StrAppend(&text, bytes);
    }
    i += bytes.size();
  }
  absl::string_view quote = quoted ? "\"" : "";
  absl::StrAppend(out, quote, text, quote, cut ? "..." : "");
}

}  // namespace

void SetLogLevel(LogLevel level) { g_level.store(level, std::memory_order_relaxed); }

bool LogEnabled(LogLevel level) { return level >= g_level.load(std::memory_order_relaxed); }

absl::StatusOr<LogLevel> ParseLogLevel(absl::string_view name) {
  if (name == "debug") return LogLevel::kDebug;
  if (name == "info") return LogLevel::kInfo;
  if (name == "warning") return LogLevel::kWarning;
  if (name == "error") return LogLevel::kError;
  return absl::InvalidArgumentError(
      absl::StrCat("unknown log level `", name, "`; use `debug`, `info`, `warning` or `error`"));
}

std::string FormatLogMessage(absl::string_view message, std::initializer_list<LogField> fields) {
  std::string line(message);
  for (const LogField& field : fields) {
    absl::StrAppend(&line, " ", field.key(), "=");
    AppendValue(field.value(), &line);
  }
  return line;
}

void Log(LogLevel level, absl::string_view message, std::initializer_list<LogField> fields) {
  if (!LogEnabled(level)) return;
  WriteLogLine(level, FormatLogLine(level, FormatLogMessage(message, fields)));
}

}  // namespace rips
