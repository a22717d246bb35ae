// What stands between the tokens of a file: comments, line breaks and blank lines.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_TRIVIA_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_TRIVIA_H_

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/diagnostic/source.h"
#include "policy_server/policy/lang/syntax/token.h"

namespace rips::lang {

struct Comment {
  // From its `#`, without white space at its end. Seen from the source's text.
  absl::string_view text;
  // Blank lines stand between it and the comment or token before it.
  bool blank_before = false;
  // White space stands before it on its line.
  bool indented = false;
};

// A comment on the line of a token belongs after that token; so do the comments on the lines right
// under one that ends a `;`'s line, in the same column. Every other comment has a line of its own
// and belongs before the next token; the end of the file is a token.
class Gaps {
 public:
  // `tokens` come from Lex(source). The text of `source` outlives this.
  Gaps(const Source& source, const std::vector<Token>& tokens);

  // Tokens are named by their index.
  std::span<const Comment> Before(size_t token) const;
  std::span<const Comment> After(size_t token) const;
  // Before the token, and any comments before it, a line ends.
  bool LineBreakBefore(size_t token) const { return gaps_[token].line_break; }
  // Right before the token, after any comments before it.
  bool BlankLineBefore(size_t token) const { return gaps_[token].blank_line; }
  // No comment stands between two of these tokens; `first` <= `last`.
  bool Clean(size_t first, size_t last) const {
    return gaps_[first].comments_end == gaps_[last].comments_end;
  }

 private:
  // Before the token of the same index. Ranges of comments_: [begin, own) belong to the token
  // before, [own, end) to this one.
  struct Gap {
    uint32_t comments_begin = 0;
    uint32_t comments_own = 0;
    uint32_t comments_end = 0;
    bool line_break = false;
    bool blank_line = false;
  };

  Gap Scan(const Source& source, uint32_t begin, uint32_t end, const Token* before);

  std::vector<Comment> comments_;
  std::vector<Gap> gaps_;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_TRIVIA_H_
