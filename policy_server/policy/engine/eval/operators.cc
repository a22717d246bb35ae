// Constants, names and operators.
#include <algorithm>
#include <type_traits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/eval/evaluation.h"
#include "services/text/utf8.h"

namespace rips::engine {
namespace {

using lang::BinaryOp;
using lang::UnaryOp;
using lang::ValueType;

// Two's complement, wrapping around.
int64_t Wrap(uint64_t value) { return static_cast<int64_t>(value); }

template <typename T>
T& Get(Slot& cell) {
  if constexpr (std::is_same_v<T, int64_t>) {
    return cell.integer;
  } else if constexpr (std::is_same_v<T, double>) {
    return cell.real;
  } else if constexpr (std::is_same_v<T, bool>) {
    return cell.truth;
  } else {
    return cell.text;
  }
}
template <typename T>
const T& Get(const Slot& cell) {
  return Get<T>(const_cast<Slot&>(cell));
}

EvalStatus Constant(const EvalNode& node, Evaluation& run, Slot& out) {
  static_cast<void>(run);
  out = node.constant;
  return EvalStatus::kValue;
}

template <typename T>
EvalStatus Variable(const EvalNode& node, Evaluation& run, Slot& out) {
  if (run.foreseeing) return EvalStatus::kUndecidable;
  using Stored = std::conditional_t<std::is_same_v<T, absl::string_view>, std::string, T>;
  const lang::Value* value = run.variables.Find(static_cast<size_t>(node.index));
  const Stored* stored = value == nullptr ? nullptr : std::get_if<Stored>(value);
  if (stored == nullptr) return run.Fault("internal: a variable that is not there");
  if constexpr (std::is_same_v<T, absl::string_view>) {
    out.text = absl::string_view(*stored);
  } else {
    Get<T>(out) = *stored;
  }
  return EvalStatus::kValue;
}

template <BinaryOp op, typename T>
bool Compared(const T& left, const T& right) {
  if constexpr (op == BinaryOp::kEq) return left == right;
  if constexpr (op == BinaryOp::kNe) return left != right;
  if constexpr (op == BinaryOp::kLt) return left < right;
  if constexpr (op == BinaryOp::kLe) return left <= right;
  if constexpr (op == BinaryOp::kGt) return left > right;
  if constexpr (op == BinaryOp::kGe) return left >= right;
}

// Integer arithmetic. False if it cannot be done.
template <BinaryOp op>
bool Computed(int64_t left, int64_t right, int64_t& out) {
  const auto a = static_cast<uint64_t>(left);
  const auto b = static_cast<uint64_t>(right);
  if constexpr (op == BinaryOp::kAdd) out = Wrap(a + b);
  if constexpr (op == BinaryOp::kSub) out = Wrap(a - b);
  if constexpr (op == BinaryOp::kMul) out = Wrap(a * b);
  if constexpr (op == BinaryOp::kBitAnd) out = left & right;
  if constexpr (op == BinaryOp::kBitOr) out = left | right;
  if constexpr (op == BinaryOp::kBitXor) out = left ^ right;
  if constexpr (op == BinaryOp::kDiv || op == BinaryOp::kMod) {
    if (right == 0) return false;
  }
  // The processor traps on the smallest integer divided by -1.
  if constexpr (op == BinaryOp::kDiv) out = right == -1 ? Wrap(uint64_t{0} - a) : left / right;
  if constexpr (op == BinaryOp::kMod) out = right == -1 ? 0 : left % right;
  return true;
}

template <BinaryOp op>
double Computed(double left, double right) {
  if constexpr (op == BinaryOp::kAdd) return left + right;
  if constexpr (op == BinaryOp::kSub) return left - right;
  if constexpr (op == BinaryOp::kMul) return left * right;
  if constexpr (op == BinaryOp::kDiv) return left / right;
}

constexpr bool Compares(BinaryOp op) { return op >= BinaryOp::kEq && op <= BinaryOp::kGe; }

template <BinaryOp op, typename T, bool constant_right>
EvalStatus Binary(const EvalNode& node, Evaluation& run, Slot& out) {
  Slot left;
  Slot right;
  EvalStatus answer = Eval(*node.left, run, left);
  if (answer == EvalStatus::kFault) return answer;
  if constexpr (constant_right) {
    right = node.constant;
  } else {
    answer = std::max(answer, Eval(*node.right, run, right));
  }
  if (answer != EvalStatus::kValue) return answer;
  const T& a = Get<T>(left);
  const T& b = Get<T>(right);
  if constexpr (Compares(op)) {
    out.truth = Compared<op, T>(a, b);
  } else if constexpr (std::is_same_v<T, int64_t>) {
    if (!Computed<op>(a, b, out.integer)) {
      return run.Fault(op == BinaryOp::kDiv ? "integer division by zero"
                                            : "integer remainder of a division by zero");
    }
  } else if constexpr (std::is_same_v<T, double>) {
    out.real = Computed<op>(a, b);
  } else {
    out.text = run.Keep(absl::StrCat(a, b));
  }
  return EvalStatus::kValue;
}

// `&&` if `decisive` is false, `||` if it is true.
template <bool decisive>
EvalStatus Logical(const EvalNode& node, Evaluation& run, Slot& out) {
  const EvalStatus left = Eval(*node.left, run, out);
  if (left == EvalStatus::kFault || (left == EvalStatus::kValue && out.truth == decisive))
    return left;
  const EvalStatus right = Eval(*node.right, run, out);
  if (right == EvalStatus::kFault || (right == EvalStatus::kValue && out.truth == decisive))
    return right;
  return std::max(left, right);
}

template <BinaryOp op, typename T>
EvalNode::Function Choose(bool constant_right) {
  return constant_right ? &Binary<op, T, true> : &Binary<op, T, false>;
}

template <typename T>
EvalNode::Function Comparison(BinaryOp op, bool constant_right) {
  switch (op) {
    case BinaryOp::kEq:
      return Choose<BinaryOp::kEq, T>(constant_right);
    case BinaryOp::kNe:
      return Choose<BinaryOp::kNe, T>(constant_right);
    case BinaryOp::kLt:
      return Choose<BinaryOp::kLt, T>(constant_right);
    case BinaryOp::kLe:
      return Choose<BinaryOp::kLe, T>(constant_right);
    case BinaryOp::kGt:
      return Choose<BinaryOp::kGt, T>(constant_right);
    case BinaryOp::kGe:
      return Choose<BinaryOp::kGe, T>(constant_right);
    default:
      return nullptr;
  }
}

template <typename T>
EvalNode::Function Arithmetic(BinaryOp op, bool constant_right) {
  switch (op) {
    case BinaryOp::kAdd:
      return Choose<BinaryOp::kAdd, T>(constant_right);
    case BinaryOp::kSub:
      return Choose<BinaryOp::kSub, T>(constant_right);
    case BinaryOp::kMul:
      return Choose<BinaryOp::kMul, T>(constant_right);
    case BinaryOp::kDiv:
      return Choose<BinaryOp::kDiv, T>(constant_right);
    default:
      return nullptr;
  }
}

EvalNode::Function BitArithmetic(BinaryOp op, bool constant_right) {
  switch (op) {
    case BinaryOp::kMod:
      return Choose<BinaryOp::kMod, int64_t>(constant_right);
    case BinaryOp::kBitAnd:
      return Choose<BinaryOp::kBitAnd, int64_t>(constant_right);
    case BinaryOp::kBitOr:
      return Choose<BinaryOp::kBitOr, int64_t>(constant_right);
    case BinaryOp::kBitXor:
      return Choose<BinaryOp::kBitXor, int64_t>(constant_right);
    default:
      return nullptr;
  }
}

template <UnaryOp op, typename T>
EvalStatus Unary(const EvalNode& node, Evaluation& run, Slot& out) {
  const EvalStatus answer = Eval(*node.left, run, out);
  if (answer != EvalStatus::kValue) return answer;
  if constexpr (op == UnaryOp::kNot) {
    out.truth = !out.truth;
  } else if constexpr (op == UnaryOp::kComplement) {
    out.integer = ~out.integer;
  } else if constexpr (op == UnaryOp::kMinus && std::is_same_v<T, double>) {
    out.real = -out.real;
  } else if constexpr (op == UnaryOp::kMinus) {
    out.integer = Wrap(uint64_t{0} - static_cast<uint64_t>(out.integer));
  }
  return EvalStatus::kValue;
}

template <lang::Predefined name>
EvalStatus Named(const EvalNode& node, Evaluation& run, Slot& out) {
  using lang::Predefined;
  static_cast<void>(node);
  // What cannot be said of the message before it is judged.
  constexpr bool kMoves = name == Predefined::kCurrLevel || name == Predefined::kLevel ||
                          name == Predefined::kTime || name == Predefined::kUptime;
  if (kMoves && run.foreseeing) return EvalStatus::kUndecidable;
  if constexpr (!kMoves) out.text = absl::string_view();
  if constexpr (name == Predefined::kCurrLevel) out.integer = run.level;
  if constexpr (name == Predefined::kLevel) out.text = run.level_name;
  if constexpr (name == Predefined::kTime) out.integer = run.time_ns;
  if constexpr (name == Predefined::kUptime) out.integer = run.uptime_ns;
  if constexpr (name == Predefined::kCurrRule) out.text = run.rule_name;
  if constexpr (name == Predefined::kRobot) out.text = run.state->robot_id;
  if (run.message != nullptr) {
    if constexpr (name == Predefined::kTopic) out.text = run.message->topic;
    if constexpr (name == Predefined::kMsgType) out.text = run.message->type;
    if constexpr (name == Predefined::kSender) out.text = run.message->sender;
    if constexpr (name == Predefined::kSenderGuid)
      out.text = run.Keep(ToString(run.message->writer));
  }
  if (run.external != nullptr) {
    if (const auto* ids = std::get_if<model::IdsAlert>(run.external)) {
      if constexpr (name == Predefined::kIdsSource) out.text = ids->src;
      if constexpr (name == Predefined::kIdsTarget) out.text = ids->dst;
    }
  }
  return EvalStatus::kValue;
}

}  // namespace

absl::string_view Evaluation::Keep(std::string text) {
  const size_t size = CutCodePoints(text, string_max).size();
  if (size < text.size()) {
    cut = true;
    text.resize(size);
  }
  texts.push_back(std::make_unique<const std::string>(std::move(text)));
  return *texts.back();
}

Scalar ToScalar(const Slot& cell, ValueType type) {
  switch (type) {
    case ValueType::kInt:
    case ValueType::kLevel:
      return cell.integer;
    case ValueType::kFloat:
      return cell.real;
    case ValueType::kBool:
      return cell.truth;
    case ValueType::kString:
      return cell.text;
  }
  return cell.integer;
}

lang::Value Own(const Slot& cell, ValueType type) {
  if (type == ValueType::kString) return std::string(cell.text);
  if (type == ValueType::kFloat) return cell.real;
  if (type == ValueType::kBool) return cell.truth;
  return cell.integer;
}

EvalNode::Function ConstantFunction() { return &Constant; }

EvalNode::Function VariableFunction(ValueType type) {
  switch (type) {
    case ValueType::kInt:
    case ValueType::kLevel:
      return &Variable<int64_t>;
    case ValueType::kFloat:
      return &Variable<double>;
    case ValueType::kBool:
      return &Variable<bool>;
    case ValueType::kString:
      return &Variable<absl::string_view>;
  }
  return nullptr;
}

EvalNode::Function PredefinedFunction(lang::Predefined name) {
  switch (name) {
#define RIPS_PREDEFINED(name, ...) \
  case lang::Predefined::k##name:  \
    return &Named<lang::Predefined::k##name>;
#include "policy_server/policy/lang/predefined.def"
  }
  return nullptr;
}

EvalNode::Function UnaryFunction(UnaryOp op, ValueType operand) {
  const bool is_int = operand == ValueType::kInt || operand == ValueType::kLevel;
  const bool is_float = operand == ValueType::kFloat;
  switch (op) {
    case UnaryOp::kPlus:
      return is_int || is_float ? &Unary<UnaryOp::kPlus, int64_t> : nullptr;
    case UnaryOp::kMinus:
      if (is_int) return &Unary<UnaryOp::kMinus, int64_t>;
      return is_float ? &Unary<UnaryOp::kMinus, double> : nullptr;
    case UnaryOp::kNot:
      return operand == ValueType::kBool ? &Unary<UnaryOp::kNot, bool> : nullptr;
    case UnaryOp::kComplement:
      return is_int ? &Unary<UnaryOp::kComplement, int64_t> : nullptr;
  }
  return nullptr;
}

EvalNode::Function BinaryFunction(BinaryOp op, ValueType operand, bool constant_right) {
  switch (operand) {
    case ValueType::kInt:
    case ValueType::kLevel:
      if (Compares(op)) return Comparison<int64_t>(op, constant_right);
      if (EvalNode::Function function = Arithmetic<int64_t>(op, constant_right)) return function;
      return BitArithmetic(op, constant_right);
    case ValueType::kFloat:
      if (Compares(op)) return Comparison<double>(op, constant_right);
      return Arithmetic<double>(op, constant_right);
    case ValueType::kString:
      if (Compares(op)) return Comparison<absl::string_view>(op, constant_right);
      if (op != BinaryOp::kAdd) return nullptr;
      return Choose<BinaryOp::kAdd, absl::string_view>(constant_right);
    case ValueType::kBool:
      if (op == BinaryOp::kAnd) return &Logical<false>;
      if (op == BinaryOp::kOr) return &Logical<true>;
      return Comparison<bool>(op, constant_right);
  }
  return nullptr;
}

}  // namespace rips::engine
