#include "policy_server/ripsctl/cli/printer.h"

#include <sys/ioctl.h>

#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
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

std::string ShellWord(absl::string_view text) {
  const bool plain = std::all_of(text.begin(), text.end(), [](char c) {
    return absl::ascii_isalnum(static_cast<unsigned char>(c)) || absl::StrContains("_./:@%+=,-", c);
  });
  if (plain && !text.empty() && text[0] != '-') return std::string(text);
  return absl::StrCat("'", absl::StrReplaceAll(EscapeText(text), {{"'", "'\\''"}}), "'");
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

std::vector<std::string> Table::Lines() const {
  std::vector<size_t> widths(rows_.front().size(), 0);
  for (const auto& row : rows_) {
    for (size_t i = 0; i < widths.size(); ++i)
      widths[i] = std::max(widths[i], CountCodePoints(row[i]));
  }
  std::vector<std::string> lines;
  for (const auto& row : rows_) {
    std::string& line = lines.emplace_back();
    for (size_t i = 0; i < widths.size(); ++i) {
      line += row[i];
      if (i + 1 < widths.size()) line.append(widths[i] - CountCodePoints(row[i]) + 2, ' ');
    }
  }
  return lines;
}

void Table::Print(TextStream out, absl::string_view margin) const {
  for (const std::string& line : Lines()) out << margin << line << "\n";
}

size_t TerminalColumns(int fd) {
  winsize size{};
  return fd >= 0 && ioctl(fd, TIOCGWINSZ, &size) == 0 ? size.ws_col : 0;
}

void PrintWrapped(absl::string_view text, absl::string_view margin, size_t columns,
                  TextStream out) {
  const size_t indent = CountCodePoints(margin);
  const std::string escaped = EscapeText(text);
  absl::string_view rest = escaped;
  const size_t width = columns > indent ? columns - indent : std::string::npos;
  do {
    absl::string_view line = CutCodePoints(rest, width);
    if (line.size() < rest.size() && rest[line.size()] != ' ') {
      const size_t blank = line.rfind(' ');
      if (blank != absl::string_view::npos && blank > 0) line = line.substr(0, blank);
    }
    rest.remove_prefix(line.size());
    rest = absl::StripLeadingAsciiWhitespace(rest);
    out << margin << absl::StripTrailingAsciiWhitespace(line) << "\n";
  } while (!rest.empty());
}

}  // namespace rips::ripsctl
