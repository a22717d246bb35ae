#include "policy_server/server/outputs/syslog_format.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/time/time.h"
#include "services/text/utf8.h"

namespace rips::outputs {
namespace {

constexpr int kFacility = 10;
constexpr size_t kMsgIdBytesMax = 32;
constexpr size_t kHostBytesMax = 255;
constexpr absl::string_view kBom = "\xEF\xBB\xBF";

int SyslogSeverity(absl::string_view severity) {
  if (severity == "critical") return 2;
  if (severity == "high") return 3;
  if (severity == "medium") return 4;
  return severity == "low" ? 5 : 6;
}

// A field of the header: printable ASCII without space.
std::string Field(absl::string_view text, size_t max) {
  if (text.empty()) return "-";
  std::string field(text.substr(0, max));
  for (char& c : field) {
    if (c <= 0x20 || c >= 0x7F) c = '_';
  }
  return field;
}

bool ChangesTheLine(char32_t value) {
  return IsControl(value) || value == 0x061C || value == 0x200E || value == 0x200F ||
         (value >= 0x2028 && value <= 0x202E) || (value >= 0x2066 && value <= 0x2069) ||
         value == 0xFEFF;
}

std::string Escape(absl::string_view text) {
  std::string escaped;
  for (size_t at = 0; at < text.size();) {
    const CodePoint point = DecodeCodePoint(text, at);
    at += point.length;
    if (point.value == '\\') {
      absl::StrAppend(&escaped, "\\\\");
    } else if (ChangesTheLine(point.value)) {
      absl::StrAppendFormat(&escaped, "\\u%04X", static_cast<uint32_t>(point.value));
    } else {
      AppendUtf8(point.value, &escaped);
    }
  }
  return escaped;
}

// PARAM-VALUE (RFC 5424 §6.3.3).
std::string Value(absl::string_view text) {
  std::string value;
  for (const char c : Escape(text)) {
    if (c == '"' || c == '\\' || c == ']') value.push_back('\\');
    value.push_back(c);
  }
  return value;
}

}  // namespace

std::string FormatSyslog(const store::AlertRecord& alert, absl::string_view host,
                         absl::string_view json) {
  const std::string time = absl::FormatTime(
      "%Y-%m-%dT%H:%M:%E6SZ", absl::FromUnixNanos(alert.time_unix_ns), absl::UTCTimeZone());
  std::string message = absl::StrCat("<", 8 * kFacility + SyslogSeverity(alert.severity), ">1 ",
                                     time, " ", Field(host, kHostBytesMax), " rips - ",
                                     Field(alert.rule, kMsgIdBytesMax), " [rips@32473");
  const std::string decision = ToString(alert.decision_id);
  const std::pair<absl::string_view, absl::string_view> values[] = {
      {"id", alert.id},       {"robot", alert.robot},
      {"rule", alert.rule},   {"severity", alert.severity},
      {"level", alert.level}, {"decision", decision}};
  for (const auto& [name, value] : values) {
    absl::StrAppend(&message, " ", name, "=\"", Value(value), "\"");
  }
  if (!alert.maintenance.empty()) {
    absl::StrAppend(&message, " maintenance=\"", Value(alert.maintenance), "\"");
  }
  absl::StrAppend(&message, "] ", kBom);
  if (!json.empty()) return absl::StrCat(message, json);
  absl::StrAppend(&message, Escape(alert.robot), ": ", Escape(alert.severity), ": ",
                  Escape(alert.text));
  if (!alert.event.empty()) absl::StrAppend(&message, " (", Escape(alert.event), ")");
  return message;
}

std::string FrameSyslog(absl::string_view message) {
  return absl::StrCat(message.size(), " ", message);
}

}  // namespace rips::outputs
