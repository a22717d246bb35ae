#include "policy_server/ripsctl/cli/printer.h"

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "absl/time/time.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
std::string ShortTime(int64_t unix_ns) {
  if (unix_ns == 0) return "-";
  return absl::FormatTime("%Y-%m-%dT%H:%M:%E3SZ", absl::FromUnixNanos(unix_ns),
                          absl::UTCTimeZone());
}

std::string FullTime(int64_t unix_ns) {
  return absl::FormatTime("%Y-%m-%dT%H:%M:%E9SZ", absl::FromUnixNanos(unix_ns),
                          absl::UTCTimeZone());
}

std::string ShortBundle(absl::string_view id) {
  constexpr size_t kDigits = 12;
  absl::string_view digits = id;
  if (!absl::ConsumePrefix(&digits, "sha256:")) return std::string(id);
  return absl::StrCat("sha256:", digits.substr(0, kDigits));
}

std::string ShortId(absl::string_view id) {
  constexpr size_t kDigits = 8;
  return std::string(id.substr(0, kDigits));
}

std::string EnumText(absl::string_view name, absl::string_view prefix,
                     absl::string_view otherwise) {
  if (name.empty() || absl::EndsWith(name, "_UNSPECIFIED")) return std::string(otherwise);
  return absl::AsciiStrToLower(absl::StripPrefix(name, prefix));
}

void Table::Add(std::vector<std::string> cells) {
  for (std::string& cell : cells) cell = cell.empty() ? "-" : EscapeText(cell);
  rows_.push_back(std::move(cells));
}

void Table::Print(std::ostream& out, absl::string_view margin) const {
  std::vector<size_t> widths(rows_.front().size(), 0);
  for (const auto& row : rows_) {
    for (size_t i = 0; i < widths.size(); ++i)
      widths[i] = std::max(widths[i], CountCodePoints(row[i]));
  }
  for (const auto& row : rows_) {
    out << margin;
    for (size_t i = 0; i < widths.size(); ++i) {
      out << row[i];
      if (i + 1 < widths.size()) out << std::string(widths[i] - CountCodePoints(row[i]) + 2, ' ');
    }
    out << "\n";
  }
}

}  // namespace rips::ripsctl
