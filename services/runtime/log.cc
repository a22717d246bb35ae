#include "services/runtime/log.h"

#include <atomic>
#include <memory>

#include "absl/strings/str_format.h"
#include "spdlog/pattern_formatter.h"
#include "spdlog/sinks/stdout_sinks.h"
#include "spdlog/spdlog.h"

namespace rips {
namespace {

// The one mutable global: a log level belongs to the process.
std::atomic<LogLevel> g_level{LogLevel::kInfo};

spdlog::logger& Logger() {
  static const std::shared_ptr<spdlog::logger> logger = [] {
    auto made =
        std::make_shared<spdlog::logger>("rips", std::make_shared<spdlog::sinks::stderr_sink_mt>());
    made->set_formatter(std::make_unique<spdlog::pattern_formatter>(
        "%Y-%m-%dT%H:%M:%S.%eZ %l %v", spdlog::pattern_time_type::utc));
    made->set_level(spdlog::level::trace);
    made->flush_on(spdlog::level::trace);
    return made;
  }();
  return *logger;
}

spdlog::level::level_enum ToSpdlog(LogLevel level) {
  switch (level) {
    case LogLevel::kDebug:
      return spdlog::level::debug;
    case LogLevel::kInfo:
      return spdlog::level::info;
    case LogLevel::kWarning:
      return spdlog::level::warn;
    case LogLevel::kError:
      return spdlog::level::err;
  }
  return spdlog::level::err;
}

// Length of the well-formed UTF-8 sequence at `text[0]`, 0 if there is none (Unicode 15, table
// 3-7); its code point goes to `*point`.
size_t DecodeUtf8(absl::string_view text, uint32_t* point) {
  const auto byte = [&](size_t i) { return static_cast<unsigned char>(text[i]); };
  const unsigned char first = byte(0);
  size_t length = 0;
  if (first < 0x80) {
    *point = first;
    return 1;
  } else if (first >= 0xc2 && first < 0xe0) {
    length = 2;
    *point = first & 0x1f;
  } else if (first >= 0xe0 && first < 0xf0) {
    length = 3;
    *point = first & 0x0f;
  } else if (first >= 0xf0 && first < 0xf5) {
    length = 4;
    *point = first & 0x07;
  } else {
    return 0;
  }
  if (text.size() < length) return 0;
  for (size_t i = 1; i < length; ++i) {
    if ((byte(i) & 0xc0) != 0x80) return 0;
    *point = (*point << 6) | (byte(i) & 0x3f);
  }
  const bool overlong = (length == 3 && *point < 0x800) || (length == 4 && *point < 0x10000);
  const bool surrogate = *point >= 0xd800 && *point < 0xe000;
  return overlong || surrogate || *point > 0x10ffff ? 0 : length;
}

// Characters that could forge a line or reorder it on a terminal.
bool IsControl(uint32_t point) {
  return point < 0x20 || (point >= 0x7f && point < 0xa0) || point == 0x200e || point == 0x200f ||
         (point >= 0x2028 && point <= 0x202e) || (point >= 0x2066 && point <= 0x2069);
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
    uint32_t point = 0;
    const size_t length = DecodeUtf8(value.substr(i), &point);
    const absl::string_view bytes = value.substr(i, length == 0 ? 1 : length);
    if (length == 0 || IsControl(point)) {
      quoted = true;
      AppendEscaped(bytes, &text);
    } else if (point == '"' || point == '\\') {
      quoted = true;
      absl::StrAppend(&text, "\\", bytes);
    } else {
      quoted = quoted || point == ' ' || point == '=';
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
  const std::string line = FormatLogMessage(message, fields);
  Logger().log(ToSpdlog(level), spdlog::string_view_t(line.data(), line.size()));
}

}  // namespace rips
