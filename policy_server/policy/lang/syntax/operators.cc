#include "policy_server/policy/lang/syntax/operators.h"

#include <cstddef>

namespace rips::lang {
namespace {

template <typename Op>
struct Row {
  Op op;
  TokenKind token;
  absl::string_view spelling;
  int precedence = 0;
};

// Each in the order of its enum.
constexpr Row<BinaryOp> kBinary[] = {
    {BinaryOp::kOr, TokenKind::kOrOr, "||", 1},
    {BinaryOp::kAnd, TokenKind::kAndAnd, "&&", 2},
    {BinaryOp::kBitOr, TokenKind::kPipe, "|", 3},
    {BinaryOp::kBitXor, TokenKind::kCaret, "^", 4},
    {BinaryOp::kBitAnd, TokenKind::kAmpersand, "&", 5},
    {BinaryOp::kEq, TokenKind::kEqualEqual, "==", 6},
    {BinaryOp::kNe, TokenKind::kBangEqual, "!=", 6},
    {BinaryOp::kLt, TokenKind::kLess, "<", 7},
    {BinaryOp::kLe, TokenKind::kLessEqual, "<=", 7},
    {BinaryOp::kGt, TokenKind::kGreater, ">", 7},
    {BinaryOp::kGe, TokenKind::kGreaterEqual, ">=", 7},
    {BinaryOp::kAdd, TokenKind::kPlus, "+", 8},
    {BinaryOp::kSub, TokenKind::kMinus, "-", 8},
    {BinaryOp::kMul, TokenKind::kStar, "*", 9},
    {BinaryOp::kDiv, TokenKind::kSlash, "/", 9},
    {BinaryOp::kMod, TokenKind::kPercent, "%", 9},
};
constexpr Row<UnaryOp> kUnary[] = {
    {UnaryOp::kPlus, TokenKind::kPlus, "+"},
    {UnaryOp::kMinus, TokenKind::kMinus, "-"},
    {UnaryOp::kNot, TokenKind::kBang, "!"},
    {UnaryOp::kComplement, TokenKind::kTilde, "~"},
};
// The arrows, a second way to write the connector, follow the enum.
constexpr Row<Connector> kConnectors[] = {
    {Connector::kEnd, TokenKind::kSemicolon, ""},
    {Connector::kIfSucceeded, TokenKind::kFatArrow, "=>"},
    {Connector::kIfFailed, TokenKind::kBangArrow, "!>"},
    {Connector::kAlways, TokenKind::kComma, ","},
    {Connector::kIfSucceeded, TokenKind::kRightArrow, "→"},
    {Connector::kIfFailed, TokenKind::kStruckArrow, "↛"},
};

template <typename Op, size_t kSize>
constexpr bool InOrder(const Row<Op> (&rows)[kSize], Op last) {
  for (size_t i = 0; i <= static_cast<size_t>(last); ++i) {
    if (static_cast<size_t>(rows[i].op) != i) return false;
  }
  return true;
}
static_assert(InOrder(kBinary, BinaryOp::kMod) && InOrder(kUnary, UnaryOp::kComplement) &&
              InOrder(kConnectors, Connector::kAlways));

template <typename Op, size_t kSize>
std::optional<Op> Find(const Row<Op> (&rows)[kSize], TokenKind token) {
  for (const Row<Op>& row : rows) {
    if (row.token == token) return row.op;
  }
  return std::nullopt;
}

}  // namespace

std::optional<BinaryOp> BinaryOpOf(TokenKind kind) { return Find(kBinary, kind); }
std::optional<UnaryOp> UnaryOpOf(TokenKind kind) { return Find(kUnary, kind); }
Connector ConnectorOf(TokenKind kind) { return Find(kConnectors, kind).value_or(Connector::kEnd); }

int Precedence(BinaryOp op) { return kBinary[static_cast<size_t>(op)].precedence; }
absl::string_view Spelling(BinaryOp op) { return kBinary[static_cast<size_t>(op)].spelling; }
absl::string_view Spelling(UnaryOp op) { return kUnary[static_cast<size_t>(op)].spelling; }
absl::string_view Spelling(Connector connector) {
  return kConnectors[static_cast<size_t>(connector)].spelling;
}

}  // namespace rips::lang
