#include "policy_server/policy/lang/check/type.h"

namespace rips::lang {
namespace {

std::optional<ValueType> If(bool condition, ValueType type) {
  return condition ? std::optional(type) : std::nullopt;
}

}  // namespace

absl::string_view Name(ValueType type) {
  switch (type) {
    case ValueType::kInt:
      return "int";
    case ValueType::kFloat:
      return "float";
    case ValueType::kBool:
      return "bool";
    case ValueType::kString:
      return "string";
    case ValueType::kLevel:
      return "level";
  }
  return "";
}

absl::string_view Name(EventClass event_class) {
  switch (event_class) {
    case EventClass::kUniversal:
      return "universal";
    case EventClass::kMsg:
      return "Msg";
    case EventClass::kGraph:
      return "Graph";
    case EventClass::kExternal:
      return "External";
  }
  return "";
}

std::optional<ValueType> TypeNamed(absl::string_view name) {
  for (const ValueType type :
       {ValueType::kInt, ValueType::kFloat, ValueType::kBool, ValueType::kString}) {
    if (Name(type) == name) return type;
  }
  return std::nullopt;
}

std::optional<EventClass> SectionNamed(absl::string_view name) {
  if (name == "Msg" || name == "MsgGraph" || name == "Message") return EventClass::kMsg;
  if (name == "Graph") return EventClass::kGraph;
  if (name == "External") return EventClass::kExternal;
  return std::nullopt;
}

bool Accepts(EventClass section, EventClass expression) {
  if (expression == EventClass::kUniversal || expression == section) return true;
  return section == EventClass::kMsg && expression == EventClass::kGraph;
}

bool Converts(ValueType from, ValueType to) {
  return from == to || (from == ValueType::kLevel && to == ValueType::kInt);
}

std::optional<ValueType> ResultType(UnaryOp op, ValueType operand) {
  const ValueType type = PlainType(operand);
  switch (op) {
    case UnaryOp::kPlus:
    case UnaryOp::kMinus:
      return If(type == ValueType::kInt || type == ValueType::kFloat, type);
    case UnaryOp::kNot:
      return If(type == ValueType::kBool, type);
    case UnaryOp::kComplement:
      return If(type == ValueType::kInt, type);
  }
  return std::nullopt;
}

std::optional<ValueType> ResultType(BinaryOp op, ValueType left, ValueType right) {
  const ValueType type = PlainType(left);
  if (type != PlainType(right)) return std::nullopt;
  const bool number = type == ValueType::kInt || type == ValueType::kFloat;
  switch (op) {
    case BinaryOp::kOr:
    case BinaryOp::kAnd:
      return If(type == ValueType::kBool, type);
    case BinaryOp::kBitOr:
    case BinaryOp::kBitXor:
    case BinaryOp::kBitAnd:
    case BinaryOp::kMod:
      return If(type == ValueType::kInt, type);
    case BinaryOp::kEq:
    case BinaryOp::kNe:
    case BinaryOp::kLt:
    case BinaryOp::kLe:
    case BinaryOp::kGt:
    case BinaryOp::kGe:
      return ValueType::kBool;
    case BinaryOp::kAdd:
      return If(number || type == ValueType::kString, type);
    case BinaryOp::kSub:
    case BinaryOp::kMul:
    case BinaryOp::kDiv:
      return If(number, type);
  }
  return std::nullopt;
}

}  // namespace rips::lang
