#include "policy_server/policy/lang/check/fold.h"

#include <cstdint>
#include <string>

#include "absl/strings/str_cat.h"

namespace rips::lang {
namespace {

uint64_t Bits(int64_t value) { return static_cast<uint64_t>(value); }
Value Int(uint64_t bits) { return static_cast<int64_t>(bits); }

template <typename T>
std::optional<Value> Compare(BinaryOp op, const T& left, const T& right) {
  if (op == BinaryOp::kEq) return left == right;
  if (op == BinaryOp::kNe) return left != right;
  if (op == BinaryOp::kLt) return left < right;
  if (op == BinaryOp::kLe) return left <= right;
  if (op == BinaryOp::kGt) return left > right;
  if (op == BinaryOp::kGe) return left >= right;
  return std::nullopt;
}

std::optional<Value> FoldInt(BinaryOp op, int64_t left, int64_t right) {
  if (op == BinaryOp::kBitOr) return Int(Bits(left) | Bits(right));
  if (op == BinaryOp::kBitXor) return Int(Bits(left) ^ Bits(right));
  if (op == BinaryOp::kBitAnd) return Int(Bits(left) & Bits(right));
  if (op == BinaryOp::kAdd) return Int(Bits(left) + Bits(right));
  if (op == BinaryOp::kSub) return Int(Bits(left) - Bits(right));
  if (op == BinaryOp::kMul) return Int(Bits(left) * Bits(right));
  if (op == BinaryOp::kDiv || op == BinaryOp::kMod) {
    if (right == 0) return std::nullopt;
    // The quotient of MinInt and -1 does not fit.
    if (right == -1) return op == BinaryOp::kDiv ? Int(0 - Bits(left)) : Int(0);
    return op == BinaryOp::kDiv ? left / right : left % right;
  }
  return Compare(op, left, right);
}

std::optional<Value> FoldFloat(BinaryOp op, double left, double right) {
  if (op == BinaryOp::kAdd) return left + right;
  if (op == BinaryOp::kSub) return left - right;
  if (op == BinaryOp::kMul) return left * right;
  if (op == BinaryOp::kDiv) return left / right;
  return Compare(op, left, right);
}

std::optional<Value> FoldBool(BinaryOp op, bool left, bool right) {
  if (op == BinaryOp::kOr) return left || right;
  if (op == BinaryOp::kAnd) return left && right;
  return Compare(op, left, right);
}

}  // namespace

Value Fold(UnaryOp op, const Value& operand) {
  switch (op) {
    case UnaryOp::kPlus:
      return operand;
    case UnaryOp::kMinus:
      if (const auto* floating = std::get_if<double>(&operand)) return -*floating;
      return Int(0 - Bits(std::get<int64_t>(operand)));
    case UnaryOp::kNot:
      return !std::get<bool>(operand);
    case UnaryOp::kComplement:
      return Int(~Bits(std::get<int64_t>(operand)));
  }
  return operand;
}

std::optional<Value> Fold(BinaryOp op, const Value& left, const Value& right) {
  if (const auto* integer = std::get_if<int64_t>(&left)) {
    return FoldInt(op, *integer, std::get<int64_t>(right));
  }
  if (const auto* floating = std::get_if<double>(&left)) {
    return FoldFloat(op, *floating, std::get<double>(right));
  }
  if (const auto* boolean = std::get_if<bool>(&left)) {
    return FoldBool(op, *boolean, std::get<bool>(right));
  }
  const std::string& text = std::get<std::string>(left);
  if (op == BinaryOp::kAdd) return absl::StrCat(text, std::get<std::string>(right));
  return Compare(op, text, std::get<std::string>(right));
}

}  // namespace rips::lang
