// The parts of an expression or action as tokens: where a long one may be broken into lines.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_BREAK_SPAN_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_BREAK_SPAN_H_

#include <cstddef>
#include <vector>

#include "policy_server/policy/lang/syntax/token.h"

namespace rips::lang {

// Tokens are named by their index in the file.
struct Piece {
  enum class Kind {
    kWord,    // one token
    kPrefix,  // an operator, then items[0]
    kRun,     // items with one operator between two, all of one precedence
    kList,    // a name or not, an opening bracket, items with commas between, a closing bracket
  };

  Kind kind = Kind::kWord;
  size_t first = 0;
  size_t last = 0;
  size_t open = 0;     // kList: the opening bracket
  int precedence = 0;  // kRun
  std::vector<Piece> items;
};

// Reads the pieces of a file that parses without errors; on another the result means nothing.
class PieceReader {
 public:
  // Not owned; outlives this.
  explicit PieceReader(const std::vector<Token>& tokens)
      : tokens_(tokens), space_before_(tokens.size(), false) {}

  // From the token `first` on.
  Piece ReadExpr(size_t first);
  // A name with arguments.
  Piece ReadCall(size_t first);
  // A list in braces.
  Piece ReadBraces(size_t first);

  // On one line a space stands before the token. Set for the tokens of the pieces that were read,
  // but for their first, and by SetSpaceBefore.
  bool space_before(size_t token) const { return space_before_[token]; }
  void SetSpaceBefore(size_t token) { space_before_[token] = true; }

 private:
  TokenKind KindOf(size_t token) const { return tokens_[token].kind; }
  Piece ReadBinary(size_t first, int precedence_min);
  Piece ReadUnary(size_t first);
  // The brackets and what is in them.
  Piece ReadList(size_t first, size_t open);

  const std::vector<Token>& tokens_;
  std::vector<bool> space_before_;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_FORMAT_BREAK_SPAN_H_
