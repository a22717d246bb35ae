// The text of one rule file and where its lines are.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_SOURCE_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_SOURCE_H_

#include <cstdint>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::lang {

// A byte order mark at the start of a file is no part of its text.
inline constexpr absl::string_view kByteOrderMark = "\xEF\xBB\xBF";

// Both from 1; the column counts code points, a tab is one, a bad byte is one, and the byte order
// mark none.
struct Position {
  int line = 1;
  int column = 1;

  friend bool operator==(const Position&, const Position&) = default;
};

class Source {
 public:
  // `file` is the index for ranges. `text` is not owned and outlives this.
  Source(uint32_t file, absl::string_view text);

  uint32_t file() const { return file_; }
  absl::string_view text() const { return text_; }
  // Where the text starts: after a byte order mark.
  uint32_t start() const { return start_; }
  // `offset` in bytes from 0; beyond the end means the end.
  Position PositionOf(uint32_t offset) const;
  // Line `line` (from 1) without its end; empty if there is none.
  absl::string_view Line(int line) const;
  // Clipped to the text.
  absl::string_view Text(SourceRange range) const;

 private:
  uint32_t file_;
  absl::string_view text_;
  uint32_t start_;
  std::vector<uint32_t> line_starts_;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_DIAGNOSTIC_SOURCE_H_
