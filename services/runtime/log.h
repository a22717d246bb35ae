// Structured log lines on stderr, one per call:
//   LogInfo("listening", {{"address", address}, {"robots", 3}});
//   2026-11-21T13:00:00.000Z info listening address=127.0.0.1:7443 robots=3
// The message is a constant; what varies goes into fields, where it is quoted and escaped, because
// names and texts of a robot are untrusted. Any thread.
#ifndef RIPS_SERVICES_RUNTIME_LOG_H_
#define RIPS_SERVICES_RUNTIME_LOG_H_

#include <initializer_list>
#include <string>
#include <type_traits>

#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace rips {

enum class LogLevel { kDebug, kInfo, kWarning, kError };

// One key=value of a line. Only for the argument list of a Log call: it holds views.
class LogField {
 public:
  // Text or a number.
  LogField(absl::string_view key, const absl::AlphaNum& value) : key_(key), value_(value.Piece()) {}
  template <typename Bool, typename = std::enable_if_t<std::is_same_v<Bool, bool>>>
  LogField(absl::string_view key, Bool value) : key_(key), value_(value ? "true" : "false") {}

  absl::string_view key() const { return key_; }
  absl::string_view value() const { return value_; }

 private:
  absl::string_view key_;
  absl::string_view value_;
};

// Bytes of one value; a longer one is cut there and marked with `...`.
inline constexpr size_t kLogValueBytesMax = 4096;

// The lowest level that is written; kInfo at start.
void SetLogLevel(LogLevel level);
bool LogEnabled(LogLevel level);
// `debug`, `info`, `warning`, `error`; InvalidArgument otherwise.
absl::StatusOr<LogLevel> ParseLogLevel(absl::string_view name);

// Writes one line now, if the level is enabled. A field's value is formatted by the caller, so
// compute nothing dear for LogDebug without asking LogEnabled first.
void Log(LogLevel level, absl::string_view message, std::initializer_list<LogField> fields);

inline void LogDebug(absl::string_view message, std::initializer_list<LogField> fields = {}) {
  Log(LogLevel::kDebug, message, fields);
}
inline void LogInfo(absl::string_view message, std::initializer_list<LogField> fields = {}) {
  Log(LogLevel::kInfo, message, fields);
}
inline void LogWarning(absl::string_view message, std::initializer_list<LogField> fields = {}) {
  Log(LogLevel::kWarning, message, fields);
}
inline void LogError(absl::string_view message, std::initializer_list<LogField> fields = {}) {
  Log(LogLevel::kError, message, fields);
}

// `message key=value ...`, the part of a line after time and level. A value is quoted if empty or
// if it holds a space, `"`, `=`, `\`, a control character or invalid UTF-8; inside quotes these are
// escaped as \n, \t, \", \\ and \xHH. Of the Unicode characters, the bidirectional and line
// controls (U+0080-9F, U+200E-F, U+2028-2E, U+2066-69) are escaped byte by byte too.
std::string FormatLogMessage(absl::string_view message, std::initializer_list<LogField> fields);

}  // namespace rips

#endif  // RIPS_SERVICES_RUNTIME_LOG_H_
