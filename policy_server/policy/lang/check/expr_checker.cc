#include "policy_server/policy/lang/check/expr_checker.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/check/fold.h"
#include "policy_server/policy/lang/check/type.h"
#include "policy_server/policy/lang/limits.h"
#include "policy_server/policy/lang/syntax/operators.h"
#include "services/text/nearest.h"
#include "services/text/quote.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

TypedExpr Constant(ValueType type, Value value, SourceRange range) {
  TypedExpr out;
  out.kind = TypedExpr::Kind::kConstant;
  out.type = type;
  out.constant = std::move(value);
  out.range = range;
  return out;
}

bool IsTrue(const TypedExpr& constant) { return std::get<bool>(constant.constant); }

bool IsZero(const TypedExpr& expr) {
  if (!expr.is_constant()) return false;
  if (const auto* integer = std::get_if<int64_t>(&expr.constant)) return *integer == 0;
  const auto* floating = std::get_if<double>(&expr.constant);
  return floating != nullptr && *floating == 0;
}

bool IsBitOperator(BinaryOp op) {
  return op == BinaryOp::kBitOr || op == BinaryOp::kBitXor || op == BinaryOp::kBitAnd;
}

// (a op b) op c and a op (b op c) are the same, in value and in what is evaluated.
bool IsAssociative(BinaryOp op, ValueType type) {
  if (op == BinaryOp::kAdd) return type != ValueType::kFloat;
  if (op == BinaryOp::kMul) return type != ValueType::kFloat;
  return op == BinaryOp::kAnd || op == BinaryOp::kOr || IsBitOperator(op);
}

SourceRange Span(SourceRange first, SourceRange last) {
  const uint32_t end = std::max(first.offset + first.length, last.offset + last.length);
  return {.file = first.file, .offset = first.offset, .length = end - first.offset};
}

}  // namespace

std::optional<TypedExpr> ExprChecker::Check(const ast::Expr& expr, const ExprContext& context) {
  std::optional<Checked> checked = CheckExpr(expr, context);
  if (!checked) return std::nullopt;
  const Truth truth = checked->truth;
  const bool is_bool = checked->typed.type == ValueType::kBool;
  if (context.condition && is_bool && truth.decided() && expr.kind != ast::Expr::Kind::kBool) {
    if (truth.may_be_true) {
      sink_.Add(DiagnosticKind::kAlwaysTrue, expr.range, "this expression is always true",
                "a rule for every event is written `true ? ...`");
    } else {
      sink_.Add(DiagnosticKind::kNeverFires, expr.range,
                "the rule can never fire: its expression is always false",
                "a rule that is meant never to fire is written `false ? ...`");
    }
  }
  if (context.condition && checked->reach.inspects && !checked->reach.narrow) {
    sink_.Add(DiagnosticKind::kInspectsEverything, expr.range,
              "this rule inspects the payloads of every topic",
              "say which with `topicin`, `topicmatches`, `msgtypein` or `msgsubtype`");
  }
  return std::move(checked->typed);
}

void ExprChecker::CheckStringList(const std::vector<ast::Expr>& list, size_t begin,
                                  absl::string_view owner, const ExprContext& context,
                                  std::vector<TypedExpr>& out) {
  std::vector<Checked> checked;
  CheckList(list, begin, owner, context, checked);
  for (Checked& item : checked) out.push_back(std::move(item.typed));
}

std::optional<ExprChecker::Checked> ExprChecker::CheckExpr(const ast::Expr& expr,
                                                           const ExprContext& context) {
  Checked out;
  switch (expr.kind) {
    case ast::Expr::Kind::kInteger:
      // 2^63 stands only after a minus, where wrapping around gives what is meant.
      out.typed = Constant(ValueType::kInt, static_cast<int64_t>(expr.integer), expr.range);
      return out;
    case ast::Expr::Kind::kFloat:
      out.typed = Constant(ValueType::kFloat, expr.floating, expr.range);
      return out;
    case ast::Expr::Kind::kString:
      out.typed = Constant(ValueType::kString, expr.text, expr.range);
      return out;
    case ast::Expr::Kind::kBool:
      out.typed = Constant(ValueType::kBool, expr.boolean, expr.range);
      out.truth = {.may_be_true = expr.boolean, .may_be_false = !expr.boolean};
      return out;
    case ast::Expr::Kind::kName:
      return CheckName(expr, context);
    case ast::Expr::Kind::kUnary:
      return CheckUnary(expr, context);
    case ast::Expr::Kind::kRun:
      return CheckRun(expr, context);
    case ast::Expr::Kind::kCall:
      return CheckCall(expr, context);
  }
  return std::nullopt;
}

std::optional<ExprChecker::Checked> ExprChecker::CheckName(const ast::Expr& expr,
                                                           const ExprContext& context) {
  Checked out;
  out.typed.range = expr.range;
  const Symbol* symbol = scope_.Find(expr.text);
  if (symbol == nullptr) {
    const PredefinedName* predefined = FindPredefined(expr.text);
    if (predefined == nullptr) {
      ReportNotAValue(expr);
      return std::nullopt;
    }
    CheckClass(expr.text, expr.range, predefined->event_class, context);
    out.typed.kind = TypedExpr::Kind::kPredefined;
    out.typed.predefined = predefined->predefined;
    out.typed.type = predefined->type;
    return out;
  }
  switch (symbol->kind) {
    case Symbol::Kind::kBroken:
      return std::nullopt;
    case Symbol::Kind::kSet:
      sink_.Add(DiagnosticKind::kNotAValue, expr.range,
                absl::StrCat(Quote(expr.text), " is a set, not a value"),
                "a set stands in a list of strings, as in `topicin(S)`");
      return std::nullopt;
    case Symbol::Kind::kConstant:
      out.typed = Constant(symbol->type, symbol->value, expr.range);
      if (symbol->type == ValueType::kBool) {
        out.truth = {.may_be_true = IsTrue(out.typed), .may_be_false = !IsTrue(out.typed)};
      }
      return out;
    case Symbol::Kind::kVariable:
      out.typed.kind = TypedExpr::Kind::kVariable;
      out.typed.variable = symbol->variable;
      out.typed.type = symbol->type;
      if (context.set_target != symbol->variable) usage_.Read(symbol->variable);
      return out;
  }
  return std::nullopt;
}

std::optional<ExprChecker::Checked> ExprChecker::CheckUnary(const ast::Expr& expr,
                                                            const ExprContext& context) {
  std::optional<Checked> operand = CheckExpr(expr.operands[0], context);
  if (!operand) return std::nullopt;
  const std::optional<ValueType> type = ResultType(expr.unary, operand->typed.type);
  if (!type) {
    sink_.Add(DiagnosticKind::kTypeMismatch,
              {.file = expr.range.file, .offset = expr.range.offset, .length = 1},
              absl::StrCat(Quote(Spelling(expr.unary)), " does not take ",
                           Quote(Name(operand->typed.type))));
    return std::nullopt;
  }
  Checked out;
  out.depth = operand->depth + 1;
  out.reach.inspects = operand->reach.inspects;
  if (expr.unary == UnaryOp::kNot) {
    out.truth = {.may_be_true = operand->truth.may_be_false,
                 .may_be_false = operand->truth.may_be_true};
  }
  if (operand->typed.is_constant()) {
    out.typed = Constant(*type, Fold(expr.unary, operand->typed.constant), expr.range);
    return out;
  }
  out.typed.kind = TypedExpr::Kind::kUnary;
  out.typed.type = *type;
  out.typed.range = expr.range;
  out.typed.unary = expr.unary;
  out.typed.args.push_back(std::move(operand->typed));
  return out;
}

std::optional<ExprChecker::Checked> ExprChecker::CheckRun(const ast::Expr& expr,
                                                          const ExprContext& context) {
  std::vector<Checked> operands;
  operands.reserve(expr.operands.size());
  for (const ast::Expr& operand : expr.operands) {
    std::optional<Checked> checked = CheckExpr(operand, context);
    if (checked) operands.push_back(std::move(*checked));
  }
  WarnMixedBitOperators(expr);
  if (operands.size() != expr.operands.size()) return std::nullopt;

  // What WarnDecided needs is kept: building moves the expressions away.
  std::vector<Checked> before(operands.size());
  for (size_t i = 0; i < operands.size(); ++i) {
    before[i].typed.type = operands[i].typed.type;
    before[i].truth = operands[i].truth;
  }
  std::optional<Checked> out = BuildRun(expr, operands);
  if (!out) return std::nullopt;
  out->typed.range = expr.range;
  if (context.condition && (out->reach.needs & (out->reach.needs - 1)) != 0 &&
      expr.operators[0].op == BinaryOp::kAnd) {
    sink_.Add(DiagnosticKind::kNeverTogether, expr.range,
              "this can never be true: it asks one event to be two things at once",
              "an event is an IDS alert, a signal, a change of an agent, a finding or a loss; join "
              "them with `||`");
  }
  if (!out->truth.decided()) {
    for (size_t i = 0; i < before.size(); ++i) {
      WarnDecided(expr.operands[i], before[i], context);
    }
  }
  return out;
}

std::optional<ExprChecker::Checked> ExprChecker::BuildRun(const ast::Expr& run,
                                                          std::vector<Checked>& operands) {
  const BinaryOp op = run.operators[0].op;
  const ValueType type = PlainType(operands[0].typed.type);
  const bool one_operator =
      std::all_of(run.operators.begin(), run.operators.end(),
                  [&](const ast::Expr::Operator& other) { return other.op == op; });
  const bool one_type = std::all_of(operands.begin(), operands.end(), [&](const Checked& other) {
    return PlainType(other.typed.type) == type;
  });
  if (one_operator && one_type && IsAssociative(op, type)) {
    return BuildBalanced(run, operands, 0, operands.size());
  }
  Checked out = std::move(operands[0]);
  for (size_t i = 0; i < run.operators.size(); ++i) {
    std::optional<Checked> next =
        Combine(run.operators[i], std::move(out), std::move(operands[i + 1]));
    if (!next) return std::nullopt;
    out = std::move(*next);
  }
  return out;
}

std::optional<ExprChecker::Checked> ExprChecker::BuildBalanced(const ast::Expr& run,
                                                               std::vector<Checked>& operands,
                                                               size_t begin, size_t end) {
  if (end - begin == 1) return std::move(operands[begin]);
  const size_t middle = begin + (end - begin + 1) / 2;
  std::optional<Checked> left = BuildBalanced(run, operands, begin, middle);
  if (!left) return std::nullopt;
  std::optional<Checked> right = BuildBalanced(run, operands, middle, end);
  if (!right) return std::nullopt;
  return Combine(run.operators[middle - 1], std::move(*left), std::move(*right));
}

std::optional<ExprChecker::Checked> ExprChecker::Combine(const ast::Expr::Operator& op,
                                                         Checked left, Checked right) {
  const std::optional<ValueType> type = ResultType(op.op, left.typed.type, right.typed.type);
  if (!type) {
    ReportTypes(op, left.typed, right.typed);
    return std::nullopt;
  }
  if ((op.op == BinaryOp::kDiv || op.op == BinaryOp::kMod) && IsZero(right.typed)) {
    sink_.Add(DiagnosticKind::kDivisionByZero, right.typed.range, "division by zero");
    return std::nullopt;
  }
  Checked out;
  out.depth = 1 + std::max(left.depth, right.depth);
  if (out.depth > kExpressionDepthMax) {
    sink_.Add(DiagnosticKind::kExpressionTooDeep, op.range,
              absl::StrCat("expression depth ", out.depth, " exceeds limit ", kExpressionDepthMax),
              "every operator of a run like `a - b - c` adds one; group with parentheses");
    return std::nullopt;
  }
  if (op.op == BinaryOp::kEq || op.op == BinaryOp::kNe) WarnComparison(left.typed, right.typed);
  const bool is_and = op.op == BinaryOp::kAnd;
  if (is_and || op.op == BinaryOp::kOr) {
    const auto both = [&](bool a, bool b) { return is_and ? a && b : a || b; };
    const auto any = [&](bool a, bool b) { return is_and ? a || b : a && b; };
    out.truth = {.may_be_true = both(left.truth.may_be_true, right.truth.may_be_true),
                 .may_be_false = any(left.truth.may_be_false, right.truth.may_be_false)};
    out.reach = Join(op.op, left, right);
    // The right side is evaluated only if the left one leaves the result open.
    if (left.typed.is_constant()) return IsTrue(left.typed) == is_and ? right : left;
  }
  const SourceRange range = Span(left.typed.range, right.typed.range);
  if (left.typed.is_constant() && right.typed.is_constant()) {
    out.typed = Constant(*type, *Fold(op.op, left.typed.constant, right.typed.constant), range);
    if (*type == ValueType::kBool) {
      out.truth = {.may_be_true = IsTrue(out.typed), .may_be_false = !IsTrue(out.typed)};
    }
    const auto* text = std::get_if<std::string>(&out.typed.constant);
    if (text != nullptr && CountCodePoints(*text) > kStringCodePointsMax) {
      sink_.Add(DiagnosticKind::kStringTooLong, range,
                absl::StrCat("a constant string of ", CountCodePoints(*text),
                             " code points exceeds limit ", kStringCodePointsMax));
      return std::nullopt;
    }
    return out;
  }
  if (op.op == BinaryOp::kEq) out.reach = Join(op.op, left, right);
  out.reach.inspects = left.reach.inspects || right.reach.inspects;
  out.typed.kind = TypedExpr::Kind::kBinary;
  out.typed.type = *type;
  out.typed.range = range;
  out.typed.binary = op.op;
  out.typed.args.reserve(2);
  out.typed.args.push_back(std::move(left.typed));
  out.typed.args.push_back(std::move(right.typed));
  return out;
}

ExprChecker::Reach ExprChecker::Join(BinaryOp op, const Checked& left, const Checked& right) {
  const Reach& a = left.reach;
  const Reach& b = right.reach;
  const bool inspects = a.inspects || b.inspects;
  if (op == BinaryOp::kAnd) return {a.narrow || b.narrow, inspects, a.needs | b.needs};
  if (op == BinaryOp::kOr) return {a.narrow && b.narrow, inspects, a.needs & b.needs};
  const auto names_topic = [](const TypedExpr& expr) {
    return expr.kind == TypedExpr::Kind::kPredefined &&
           (expr.predefined == Predefined::kTopic || expr.predefined == Predefined::kMsgType);
  };
  return {names_topic(left.typed) || names_topic(right.typed), inspects, 0};
}

void ExprChecker::ReportTypes(const ast::Expr::Operator& op, const TypedExpr& left,
                              const TypedExpr& right) {
  const std::string spelling = Quote(Spelling(op.op));
  const ValueType l = PlainType(left.type);
  const ValueType r = PlainType(right.type);
  if (l == r) {
    sink_.Add(DiagnosticKind::kTypeMismatch, op.range,
              absl::StrCat(spelling, " does not take ", Quote(Name(l))));
    return;
  }
  const TypedExpr& text = l == ValueType::kString ? left : right;
  const TypedExpr& other = l == ValueType::kString ? right : left;
  if (other.type == ValueType::kLevel && text.type == ValueType::kString) {
    sink_.Add(DiagnosticKind::kTypeMismatch, op.range,
              absl::StrCat(spelling, " cannot join a level and text"),
              text.kind == TypedExpr::Kind::kPredefined
                  ? "`CurrLevel` is the level itself, `Level` is its name"
                  : "levels are written without quotes");
    return;
  }
  std::string hint = "there is no implicit conversion";
  if (op.op == BinaryOp::kAdd && (l == ValueType::kString || r == ValueType::kString)) {
    absl::StrAppend(&hint, "; `string(x)` makes a string of any value");
  } else if (l != ValueType::kString && r != ValueType::kString && l != ValueType::kBool &&
             r != ValueType::kBool) {
    absl::StrAppend(&hint, "; an integral float is written with a dot, like `1.0`");
  }
  sink_.Add(DiagnosticKind::kTypeMismatch, op.range,
            absl::StrCat(spelling, " cannot join ", Quote(Name(l)), " and ", Quote(Name(r))),
            std::move(hint));
}

void ExprChecker::WarnMixedBitOperators(const ast::Expr& run) {
  const BinaryOp outer = run.operators[0].op;
  if (!IsBitOperator(outer)) return;
  for (const ast::Expr& operand : run.operands) {
    if (operand.kind != ast::Expr::Kind::kRun || operand.parenthesized) continue;
    const BinaryOp inner = operand.operators[0].op;
    if (!IsBitOperator(inner)) continue;
    sink_.Add(DiagnosticKind::kMixedBitOperators, operand.range,
              absl::StrCat(Quote(Spelling(inner)), " binds tighter than ", Quote(Spelling(outer)),
                           " here, as in C"),
              "other tools read it the other way round; say what is meant with parentheses");
  }
}

void ExprChecker::WarnDecided(const ast::Expr& part, const Checked& checked,
                              const ExprContext& context) {
  if (!context.condition || checked.typed.type != ValueType::kBool || !checked.truth.decided() ||
      part.kind == ast::Expr::Kind::kBool) {
    return;
  }
  if (checked.truth.may_be_true) {
    sink_.Add(DiagnosticKind::kAlwaysTrue, part.range, "this part is always true");
  } else {
    sink_.Add(DiagnosticKind::kAlwaysFalse, part.range, "this part is always false");
  }
}

void ExprChecker::ReportNotAValue(const ast::Expr& name) {
  const std::string quoted = Quote(name.text);
  if (const Signature* signature = FindSignature(name.text)) {
    sink_.Add(DiagnosticKind::kNotAValue, name.range,
              absl::StrCat(quoted, " is a builtin, not a value"),
              absl::StrCat("call it: `", UsageOf(*signature), "`"));
  } else if (FindAction(name.text) != nullptr) {
    sink_.Add(DiagnosticKind::kActionInExpression, name.range,
              absl::StrCat(quoted, " is an action; it cannot be used in an expression"),
              "actions stand after the `?`");
  } else if (scope_.DeclaredLater(name.text)) {
    sink_.Add(DiagnosticKind::kUnknownName, name.range,
              absl::StrCat(quoted, " is declared only further on"),
              "a name must be declared before it is used; move its declaration up");
  } else if (!sink_.Full(name.range.file)) {
    std::vector<absl::string_view> known = scope_.names();
    for (const PredefinedName& predefined : PredefinedNames()) known.push_back(predefined.name);
    std::string hint = NearestHint(name.text, known);
    if (hint.empty()) {
      hint = absl::StrCat("declare it under `vars:` or `consts:`; text is written in quotes: `\"",
                          name.text, "\"`");
    }
    sink_.Add(DiagnosticKind::kUnknownName, name.range, absl::StrCat("unknown name ", quoted),
              std::move(hint));
  }
}

}  // namespace rips::lang
