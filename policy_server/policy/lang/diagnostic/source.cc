#include "policy_server/policy/lang/diagnostic/source.h"

#include <algorithm>

#include "absl/strings/match.h"
#include "absl/strings/strip.h"
#include "services/text/utf8.h"

namespace rips::lang {

Source::Source(uint32_t file, absl::string_view text) : file_(file), text_(text) {
  start_ = absl::StartsWith(text, kByteOrderMark) ? kByteOrderMark.size() : 0;
  line_starts_.push_back(start_);
  for (uint32_t i = start_; i < text.size(); ++i) {
    if (text[i] == '\n') line_starts_.push_back(i + 1);
  }
}

Position Source::PositionOf(uint32_t offset) const {
  offset = std::clamp(offset, start_, static_cast<uint32_t>(text_.size()));
  const auto next = std::upper_bound(line_starts_.begin(), line_starts_.end(), offset);
  const uint32_t line_start = *(next - 1);
  const size_t before = CountCodePoints(text_.substr(line_start, offset - line_start));
  return {.line = static_cast<int>(next - line_starts_.begin()),
          .column = static_cast<int>(before) + 1};
}

absl::string_view Source::Line(int line) const {
  if (line < 1 || static_cast<size_t>(line) > line_starts_.size()) return {};
  const uint32_t begin = line_starts_[line - 1];
  absl::string_view rest = text_.substr(begin);
  rest = rest.substr(0, rest.find('\n'));
  return absl::StripSuffix(rest, "\r");
}

absl::string_view Source::Text(SourceRange range) const {
  if (range.offset >= text_.size()) return {};
  return text_.substr(range.offset, range.length);
}

}  // namespace rips::lang
