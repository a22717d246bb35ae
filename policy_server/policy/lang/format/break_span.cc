#include "policy_server/policy/lang/format/break_span.h"

#include <optional>
#include <utility>

#include "policy_server/policy/lang/syntax/operators.h"

namespace rips::lang {

Piece PieceReader::ReadExpr(size_t first) { return ReadBinary(first, 1); }

Piece PieceReader::ReadCall(size_t first) { return ReadList(first, first + 1); }

Piece PieceReader::ReadBraces(size_t first) { return ReadList(first, first); }

Piece PieceReader::ReadBinary(size_t first, int precedence_min) {
  Piece left = ReadUnary(first);
  while (const std::optional<BinaryOp> op = BinaryOpOf(KindOf(left.last + 1))) {
    const int precedence = Precedence(*op);
    if (precedence < precedence_min) break;
    SetSpaceBefore(left.last + 1);
    SetSpaceBefore(left.last + 2);
    Piece right = ReadBinary(left.last + 2, precedence + 1);
    if (left.kind != Piece::Kind::kRun || left.precedence != precedence) {
      Piece run{.kind = Piece::Kind::kRun, .first = first, .precedence = precedence};
      run.items.push_back(std::move(left));
      left = std::move(run);
    }
    left.last = right.last;
    left.items.push_back(std::move(right));
  }
  return left;
}

Piece PieceReader::ReadUnary(size_t first) {
  if (UnaryOpOf(KindOf(first))) {
    Piece prefix{.kind = Piece::Kind::kPrefix, .first = first};
    prefix.items.push_back(ReadUnary(first + 1));
    prefix.last = prefix.items[0].last;
    return prefix;
  }
  if (KindOf(first) == TokenKind::kOpenParen) return ReadList(first, first);
  if (KindOf(first) == TokenKind::kIdentifier && KindOf(first + 1) == TokenKind::kOpenParen) {
    return ReadCall(first);
  }
  return {.kind = Piece::Kind::kWord, .first = first, .last = first};
}

Piece PieceReader::ReadList(size_t first, size_t open) {
  const TokenKind close =
      KindOf(open) == TokenKind::kOpenBrace ? TokenKind::kCloseBrace : TokenKind::kCloseParen;
  Piece list{.kind = Piece::Kind::kList, .first = first, .open = open};
  size_t at = open + 1;
  while (KindOf(at) != close) {
    list.items.push_back(ReadBinary(at, 1));
    at = list.items.back().last + 1;
    if (KindOf(at) != TokenKind::kComma) break;
    ++at;
    if (KindOf(at) != close) SetSpaceBefore(at);
  }
  list.last = at;
  return list;
}

}  // namespace rips::lang
