#include "policy_server/engine/expression.h"

#include <type_traits>
#include <utility>

#include "absl/container/inlined_vector.h"
#include "absl/strings/str_cat.h"
#include "policy_server/engine/compiled.h"
#include "policy_server/engine/text.h"

namespace rips::engine {
namespace {

using lang::BinaryOp;
using lang::TypedExpr;
using lang::UnaryOp;

// The checker lets none of these through; if one comes, one rule fails and not the server.
constexpr absl::string_view kIllTyped = "an operand of the wrong type";

// Two's complement, wrapping around.
int64_t Wrap(uint64_t value) { return static_cast<int64_t>(value); }

template <typename T>
std::optional<bool> Order(BinaryOp op, const T& left, const T& right) {
  switch (op) {
    case BinaryOp::kEq:
      return left == right;
    case BinaryOp::kNe:
      return left != right;
    case BinaryOp::kLt:
      return left < right;
    case BinaryOp::kLe:
      return left <= right;
    case BinaryOp::kGt:
      return left > right;
    case BinaryOp::kGe:
      return left >= right;
    default:
      return std::nullopt;
  }
}

std::optional<double> ApplyFloat(BinaryOp op, double left, double right) {
  switch (op) {
    case BinaryOp::kAdd:
      return left + right;
    case BinaryOp::kSub:
      return left - right;
    case BinaryOp::kMul:
      return left * right;
    case BinaryOp::kDiv:
      return left / right;
    default:
      return std::nullopt;
  }
}

}  // namespace

lang::Value Own(const Scalar& scalar) {
  return std::visit(
      [](const auto& value) -> lang::Value {
        if constexpr (std::is_same_v<std::decay_t<decltype(value)>, absl::string_view>) {
          return std::string(value);
        } else {
          return value;
        }
      },
      scalar);
}

Scalar View(const lang::Value& value) {
  return std::visit(
      [](const auto& v) -> Scalar {
        if constexpr (std::is_same_v<std::decay_t<decltype(v)>, std::string>) {
          return absl::string_view(v);
        } else {
          return v;
        }
      },
      value);
}

std::optional<Scalar> Expression::Eval(const TypedExpr& expr) {
  // The left side of a run of operators is followed without recursion: a run is as deep as it is
  // long, everything else is bounded by the checker's nesting limit.
  absl::InlinedVector<const TypedExpr*, 8> run;
  const TypedExpr* at = &expr;
  while (at->kind == TypedExpr::Kind::kBinary && at->args.size() == 2) {
    run.push_back(at);
    at = &at->args[0];
  }
  std::optional<Scalar> left = EvalOperand(*at);
  for (; !run.empty() && left.has_value(); run.pop_back()) {
    const TypedExpr& node = *run.back();
    const bool logical = node.binary == BinaryOp::kAnd || node.binary == BinaryOp::kOr;
    if (logical) {
      const bool* truth = std::get_if<bool>(&*left);
      if (truth == nullptr) return Fault(kIllTyped);
      if (*truth == (node.binary == BinaryOp::kOr)) continue;
    }
    std::optional<Scalar> right = Eval(node.args[1]);
    if (!right.has_value()) return std::nullopt;
    if (!logical) {
      left = Apply(node.binary, *left, *right);
    } else if (std::holds_alternative<bool>(*right)) {
      left = right;
    } else {
      return Fault(kIllTyped);
    }
  }
  return left;
}

std::optional<Scalar> Expression::EvalOperand(const TypedExpr& expr) {
  switch (expr.kind) {
    case TypedExpr::Kind::kConstant:
      return View(expr.constant);
    case TypedExpr::Kind::kVariable: {
      const lang::Value* value = context_.variables.Find(expr.variable);
      if (value == nullptr) return Fault("an unknown variable");
      return View(*value);
    }
    case TypedExpr::Kind::kPredefined:
      return EvalPredefined(expr.predefined);
    case TypedExpr::Kind::kUnary:
      return EvalUnary(expr);
    case TypedExpr::Kind::kBinary:
      return Fault(kIllTyped);
    case TypedExpr::Kind::kCall:
      return EvalCall(expr);
  }
  return Fault(kIllTyped);
}

std::optional<Scalar> Expression::EvalPredefined(lang::Predefined name) const {
  switch (name) {
    case lang::Predefined::kCurrLevel:
      return int64_t{context_.level};
    case lang::Predefined::kLevel:
      return context_.level_name;
    case lang::Predefined::kTime:
      return context_.time_ns;
    case lang::Predefined::kUptime:
      return context_.uptime_ns;
    case lang::Predefined::kCurrRule:
      return absl::string_view(context_.rule.name);
  }
  return std::nullopt;
}

std::optional<Scalar> Expression::EvalUnary(const TypedExpr& expr) {
  if (expr.args.size() != 1) return Fault(kIllTyped);
  const std::optional<Scalar> value = Eval(expr.args[0]);
  if (!value.has_value()) return std::nullopt;
  const int64_t* integer = std::get_if<int64_t>(&*value);
  const double* real = std::get_if<double>(&*value);
  const bool* truth = std::get_if<bool>(&*value);
  switch (expr.unary) {
    case UnaryOp::kPlus:
      if (integer != nullptr || real != nullptr) return value;
      break;
    case UnaryOp::kMinus:
      if (integer != nullptr) return Wrap(uint64_t{0} - static_cast<uint64_t>(*integer));
      if (real != nullptr) return -*real;
      break;
    case UnaryOp::kNot:
      if (truth != nullptr) return !*truth;
      break;
    case UnaryOp::kComplement:
      if (integer != nullptr) return ~*integer;
      break;
  }
  return Fault(kIllTyped);
}

std::optional<Scalar> Expression::EvalCall(const TypedExpr& expr) {
  const Program::Compiled& compiled = context_.program.compiled();
  const auto predicate = compiled.predicate_of.find(&expr);
  if (predicate != compiled.predicate_of.end()) {
    if (context_.verdict != nullptr) return bool{context_.verdict->holds[predicate->second]};
    return Holds(compiled.predicates[predicate->second], context_.scene);
  }

  absl::InlinedVector<Scalar, 4> args;
  args.reserve(expr.args.size());
  for (const TypedExpr& arg : expr.args) {
    std::optional<Scalar> value = Eval(arg);
    if (!value.has_value()) return std::nullopt;
    args.push_back(*value);
  }
  if (expr.builtin == lang::Builtin::kString && args.size() == 1) return ToText(args[0]);
  if (expr.builtin == lang::Builtin::kLevelName && args.size() == 1) {
    const int64_t* index = std::get_if<int64_t>(&args[0]);
    if (index == nullptr) return Fault(kIllTyped);
    const levels::LevelTable& table = context_.program.rules().levels;
    if (*index < 0 || *index >= table.size()) return absl::string_view();
    return absl::string_view(table.at(static_cast<levels::LevelIndex>(*index)).name);
  }
  const std::optional<bool> answer = Ask(expr.builtin, args, context_.scene);
  if (!answer.has_value()) return Fault(kIllTyped);
  return *answer;
}

std::optional<Scalar> Expression::Apply(BinaryOp op, const Scalar& left, const Scalar& right) {
  if (left.index() != right.index()) return Fault(kIllTyped);
  if (const auto* integer = std::get_if<int64_t>(&left)) {
    return ApplyInt(op, *integer, std::get<int64_t>(right));
  }
  if (const auto* text = std::get_if<absl::string_view>(&left)) {
    const absl::string_view other = std::get<absl::string_view>(right);
    if (op == BinaryOp::kAdd) return Concat(*text, other);
    if (const std::optional<bool> order = Order(op, *text, other)) return *order;
  } else if (const auto* real = std::get_if<double>(&left)) {
    const double other = std::get<double>(right);
    if (const std::optional<double> value = ApplyFloat(op, *real, other)) return *value;
    if (const std::optional<bool> order = Order(op, *real, other)) return *order;
  } else if (const std::optional<bool> order =
                 Order(op, std::get<bool>(left), std::get<bool>(right))) {
    return *order;
  }
  return Fault(kIllTyped);
}

std::optional<Scalar> Expression::ApplyInt(BinaryOp op, int64_t left, int64_t right) {
  const auto a = static_cast<uint64_t>(left);
  const auto b = static_cast<uint64_t>(right);
  switch (op) {
    case BinaryOp::kAdd:
      return Wrap(a + b);
    case BinaryOp::kSub:
      return Wrap(a - b);
    case BinaryOp::kMul:
      return Wrap(a * b);
    case BinaryOp::kDiv:
      if (right == 0) return Fault("integer division by zero");
      // The processor traps on the smallest integer divided by -1.
      return right == -1 ? Wrap(uint64_t{0} - a) : left / right;
    case BinaryOp::kMod:
      if (right == 0) return Fault("integer remainder of a division by zero");
      return right == -1 ? int64_t{0} : left % right;
    case BinaryOp::kBitAnd:
      return left & right;
    case BinaryOp::kBitOr:
      return left | right;
    case BinaryOp::kBitXor:
      return left ^ right;
    default:
      break;
  }
  const std::optional<bool> order = Order(op, left, right);
  if (!order.has_value()) return Fault(kIllTyped);
  return *order;
}

std::optional<Scalar> Expression::Concat(absl::string_view left, absl::string_view right) {
  return Keep(absl::StrCat(left, right));
}

std::optional<Scalar> Expression::ToText(const Scalar& value) {
  if (std::holds_alternative<absl::string_view>(value)) return value;
  if (const auto* integer = std::get_if<int64_t>(&value)) return Keep(absl::StrCat(*integer));
  if (const auto* real = std::get_if<double>(&value)) return Keep(FormatFloat(*real));
  return absl::string_view(std::get<bool>(value) ? "true" : "false");
}

Scalar Expression::Keep(std::string text) {
  const size_t size = CutCodePoints(text, context_.string_max).size();
  if (size < text.size()) {
    cut_ = true;
    text.resize(size);
  }
  texts_.push_back(std::make_unique<const std::string>(std::move(text)));
  return absl::string_view(*texts_.back());
}

}  // namespace rips::engine
