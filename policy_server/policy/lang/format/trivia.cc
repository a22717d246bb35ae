#include "policy_server/policy/lang/format/trivia.h"

#include <algorithm>

#include "absl/strings/ascii.h"

namespace rips::lang {

Gaps::Gaps(const Source& source, const std::vector<Token>& tokens) {
  gaps_.reserve(tokens.size());
  uint32_t at = source.start();
  const Token* before = nullptr;
  for (const Token& token : tokens) {
    gaps_.push_back(Scan(source, at, token.offset, before));
    at = token.end();
    before = &token;
  }
}

std::span<const Comment> Gaps::Before(size_t token) const {
  const Gap& gap = gaps_[token];
  return std::span(comments_).subspan(gap.comments_own, gap.comments_end - gap.comments_own);
}

std::span<const Comment> Gaps::After(size_t token) const {
  if (token + 1 >= gaps_.size()) return {};
  const Gap& gap = gaps_[token + 1];
  return std::span(comments_).subspan(gap.comments_begin, gap.comments_own - gap.comments_begin);
}

Gaps::Gap Gaps::Scan(const Source& source, uint32_t begin, uint32_t end, const Token* before) {
  const absl::string_view text = source.text();
  Gap gap;
  gap.comments_begin = gap.comments_own = static_cast<uint32_t>(comments_.size());
  int line_ends = 0;  // since the token or comment before
  int column = 0;     // of a comment under which others continue
  for (uint32_t at = begin; at < end;) {
    if (text[at] != '#') {
      if (text[at] == '\n') ++line_ends;
      gap.line_break |= text[at] == '\n';
      ++at;
      continue;
    }
    const auto length = static_cast<uint32_t>(std::min<size_t>(text.find('\n', at), end) - at);
    const bool trailing = before != nullptr && !gap.line_break;
    const bool continues = column > 0 && line_ends == 1 && source.PositionOf(at).column == column;
    if (trailing && before->kind == TokenKind::kSemicolon) column = source.PositionOf(at).column;
    if (!trailing && !continues) column = 0;
    comments_.push_back({.text = absl::StripTrailingAsciiWhitespace(text.substr(at, length)),
                         .blank_before = line_ends > 1,
                         .indented = at > source.start() && text[at - 1] != '\n'});
    if (trailing || continues) gap.comments_own = static_cast<uint32_t>(comments_.size());
    line_ends = 0;
    at += length;
  }
  gap.comments_end = static_cast<uint32_t>(comments_.size());
  gap.blank_line = line_ends > 1;
  return gap;
}

}  // namespace rips::lang
