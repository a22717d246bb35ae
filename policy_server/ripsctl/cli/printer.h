// Text on a terminal: columns aligned, times readable, nothing hostile (services/text/escape.h).
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_PRINTER_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_PRINTER_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/cli/text_stream.h"
#include "services/text/escape.h"

namespace rips::ripsctl {

// `2026-01-01T00:00:00.000Z`; `-` for 0.
std::string ShortTime(int64_t unix_ns);
// RFC 3339, UTC, nanoseconds.
std::string FullTime(int64_t unix_ns);

// `sha256:` and the first 12 digits.
std::string ShortBundle(absl::string_view id);
// The first 8 digits of an alert's or a level change's id, enough for `ripsctl explain`.
std::string ShortId(absl::string_view id);

// `text` as a word of a command that the operator may copy: escaped, and in single quotes unless a
// shell takes it as it is. A server must not write the operator's commands.
std::string ShellWord(absl::string_view text);

// `name` of a value of a protobuf enum in lower case, without `prefix`; `otherwise` for one that
// has no name or is unspecified.
std::string EnumText(absl::string_view name, absl::string_view prefix, absl::string_view otherwise);

// Columns of the terminal `fd`; 0 if it is none, or does not say.
size_t TerminalColumns(int fd);

// `text`, escaped, each line behind `margin` and with it at most `columns` code points wide: broken
// at blanks, and within a word that is longer than a line. `columns` 0 or no wider than `margin`:
// one line.
void PrintWrapped(absl::string_view text, absl::string_view margin, size_t columns, TextStream out);

// Columns two spaces apart, as wide as their widest cell in code points; the last is not padded.
class Table {
 public:
  explicit Table(std::vector<std::string> header) : rows_{std::move(header)} {}
  // Cells are escaped; an empty one shows as `-`. As many as the header has.
  void Add(std::vector<std::string> cells);
  // Each line behind `margin`.
  void Print(TextStream out, absl::string_view margin = "") const;
  // What Print writes, line by line, the header first, without the line ends.
  std::vector<std::string> Lines() const;

 private:
  std::vector<std::vector<std::string>> rows_;
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_PRINTER_H_
