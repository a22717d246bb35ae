#include "policy_server/policy/lang/syntax/ast.h"

namespace rips::lang::ast {

int Precedence(BinaryOp op) {
  switch (op) {
    case BinaryOp::kOr:
      return 1;
    case BinaryOp::kAnd:
      return 2;
    case BinaryOp::kBitOr:
      return 3;
    case BinaryOp::kBitXor:
      return 4;
    case BinaryOp::kBitAnd:
      return 5;
    case BinaryOp::kEq:
    case BinaryOp::kNe:
      return 6;
    case BinaryOp::kLt:
    case BinaryOp::kLe:
    case BinaryOp::kGt:
    case BinaryOp::kGe:
      return 7;
    case BinaryOp::kAdd:
    case BinaryOp::kSub:
      return 8;
    case BinaryOp::kMul:
    case BinaryOp::kDiv:
    case BinaryOp::kMod:
      return 9;
  }
  return 0;
}

absl::string_view Spelling(BinaryOp op) {
  switch (op) {
    case BinaryOp::kOr:
      return "||";
    case BinaryOp::kAnd:
      return "&&";
    case BinaryOp::kBitOr:
      return "|";
    case BinaryOp::kBitXor:
      return "^";
    case BinaryOp::kBitAnd:
      return "&";
    case BinaryOp::kEq:
      return "==";
    case BinaryOp::kNe:
      return "!=";
    case BinaryOp::kLt:
      return "<";
    case BinaryOp::kLe:
      return "<=";
    case BinaryOp::kGt:
      return ">";
    case BinaryOp::kGe:
      return ">=";
    case BinaryOp::kAdd:
      return "+";
    case BinaryOp::kSub:
      return "-";
    case BinaryOp::kMul:
      return "*";
    case BinaryOp::kDiv:
      return "/";
    case BinaryOp::kMod:
      return "%";
  }
  return "";
}

absl::string_view Spelling(UnaryOp op) {
  switch (op) {
    case UnaryOp::kPlus:
      return "+";
    case UnaryOp::kMinus:
      return "-";
    case UnaryOp::kNot:
      return "!";
    case UnaryOp::kComplement:
      return "~";
  }
  return "";
}

absl::string_view Spelling(Connector connector) {
  switch (connector) {
    case Connector::kEnd:
      return "";
    case Connector::kIfSucceeded:
      return "=>";
    case Connector::kIfFailed:
      return "!>";
    case Connector::kAlways:
      return ",";
  }
  return "";
}

}  // namespace rips::lang::ast
