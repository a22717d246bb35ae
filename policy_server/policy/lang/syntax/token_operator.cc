#include "policy_server/policy/lang/syntax/token_operator.h"

#include <utility>

namespace rips::lang {

std::optional<BinaryOp> BinaryOpOf(TokenKind kind) {
  static constexpr std::pair<TokenKind, BinaryOp> kOperators[] = {
      {TokenKind::kOrOr, BinaryOp::kOr},          {TokenKind::kAndAnd, BinaryOp::kAnd},
      {TokenKind::kPipe, BinaryOp::kBitOr},       {TokenKind::kCaret, BinaryOp::kBitXor},
      {TokenKind::kAmpersand, BinaryOp::kBitAnd}, {TokenKind::kEqualEqual, BinaryOp::kEq},
      {TokenKind::kBangEqual, BinaryOp::kNe},     {TokenKind::kLess, BinaryOp::kLt},
      {TokenKind::kLessEqual, BinaryOp::kLe},     {TokenKind::kGreater, BinaryOp::kGt},
      {TokenKind::kGreaterEqual, BinaryOp::kGe},  {TokenKind::kPlus, BinaryOp::kAdd},
      {TokenKind::kMinus, BinaryOp::kSub},        {TokenKind::kStar, BinaryOp::kMul},
      {TokenKind::kSlash, BinaryOp::kDiv},        {TokenKind::kPercent, BinaryOp::kMod},
  };
  for (const auto& [token, op] : kOperators) {
    if (token == kind) return op;
  }
  return std::nullopt;
}

std::optional<UnaryOp> UnaryOpOf(TokenKind kind) {
  static constexpr std::pair<TokenKind, UnaryOp> kOperators[] = {
      {TokenKind::kPlus, UnaryOp::kPlus},
      {TokenKind::kMinus, UnaryOp::kMinus},
      {TokenKind::kBang, UnaryOp::kNot},
      {TokenKind::kTilde, UnaryOp::kComplement},
  };
  for (const auto& [token, op] : kOperators) {
    if (token == kind) return op;
  }
  return std::nullopt;
}

Connector ConnectorOf(TokenKind kind) {
  static constexpr std::pair<TokenKind, Connector> kConnectors[] = {
      {TokenKind::kFatArrow, Connector::kIfSucceeded},
      {TokenKind::kRightArrow, Connector::kIfSucceeded},
      {TokenKind::kBangArrow, Connector::kIfFailed},
      {TokenKind::kStruckArrow, Connector::kIfFailed},
      {TokenKind::kComma, Connector::kAlways},
  };
  for (const auto& [token, connector] : kConnectors) {
    if (token == kind) return connector;
  }
  return Connector::kEnd;
}

}  // namespace rips::lang
