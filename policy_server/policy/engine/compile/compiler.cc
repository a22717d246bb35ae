// Checked rules to what the evaluator runs: CompiledPolicy::Create.

#include <algorithm>
#include <memory>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/builtins/builtins.h"
#include "policy_server/policy/engine/builtins/question.h"
#include "policy_server/policy/engine/eval/evaluation.h"
#include "policy_server/policy/engine/state/compiled.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "policy_server/policy/engine/state/topic_verdicts.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/limits.h"
#include "services/base/clock.h"
#include "services/base/status_macros.h"

namespace rips::engine {
namespace {

using lang::BinaryOp;
using lang::Builtin;
using lang::EventClass;
using lang::TypedExpr;
using lang::ValueType;

bool IsConstant(const EvalNode* node) { return node->function == ConstantFunction(); }

bool SameType(ValueType a, ValueType b) { return PlainType(a) == PlainType(b); }

absl::Status IllTyped() { return absl::InvalidArgumentError("an operand of the wrong type"); }

// Equal for calls that ask the same, with the same constants.
std::string KeyOf(const Predicate& predicate) {
  std::string key = absl::StrCat(static_cast<int>(predicate.builtin));
  for (const Scalar& arg : predicate.args) {
    if (const auto* text = std::get_if<absl::string_view>(&arg)) {
      absl::StrAppend(&key, "|", text->size(), ":", *text);
    } else if (const auto* integer = std::get_if<int64_t>(&arg)) {
      absl::StrAppend(&key, "#", *integer);
    }
  }
  return key;
}

absl::StatusOr<std::unique_ptr<const RE2>> CompilePattern(absl::string_view pattern) {
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(lang::kRegexBytesMax);
  auto regex =
      std::make_unique<const RE2>(re2::StringPiece(pattern.data(), pattern.size()), options);
  if (regex->ok()) return regex;
  return absl::InvalidArgumentError(
      absl::StrCat("`topicmatches(\"", pattern, "\")`: ", regex->error()));
}

class Compiler {
 public:
  explicit Compiler(const lang::CheckedRules& rules) : rules_(rules) {}

  absl::StatusOr<std::unique_ptr<const CompiledPolicy::Compiled>> Run() {
    for (uint32_t i = 0; i < rules_.variables.size(); ++i) {
      out_->variable_of.emplace(rules_.variables[i].name, i);
    }
    out_->holds_level.resize(rules_.variables.size());
    for (uint32_t i = 0; i < rules_.rules.size(); ++i) {
      const absl::Status status = AddRule(i);
      if (!status.ok()) {
        return absl::Status(status.code(),
                            absl::StrCat("rule `", rules_.rules[i].name, "`: ", status.message()));
      }
    }
    out_->patterns.Seal();
    return std::move(out_);
  }

 private:
  absl::Status AddRule(uint32_t index) {
    const lang::TypedRule& rule = rules_.rules[index];
    needs_ = {};
    RIPS_ASSIGN_OR_RETURN(const EvalNode* condition, Expr(rule.condition));
    if (condition->type != ValueType::kBool) return IllTyped();
    in_arguments_ = true;
    for (const lang::TypedChain& chain : rule.chains) {
      for (const lang::TypedAction& action : chain) RIPS_RETURN_IF_ERROR(AddAction(action));
    }
    in_arguments_ = false;
    out_->conditions.push_back(condition);
    out_->needs.push_back(std::move(needs_));
    if (NeverFires(rule.condition)) return absl::OkStatus();
    switch (rule.section) {
      case EventClass::kMsg:
        out_->message_rules.push_back(index);
        out_->topic_window_ns = std::max(out_->topic_window_ns, out_->needs[index].topic_window_ns);
        out_->sender_window_ns =
            std::max(out_->sender_window_ns, out_->needs[index].sender_window_ns);
        return absl::OkStatus();
      case EventClass::kGraph:
        out_->graph_rules.push_back(index);
        return absl::OkStatus();
      case EventClass::kExternal:
        out_->external_rules.push_back(index);
        return absl::OkStatus();
      case EventClass::kUniversal:
        break;
    }
    return absl::InvalidArgumentError("it has no section");
  }

  absl::Status AddAction(const lang::TypedAction& action) {
    using lang::ActionKind;
    needs_.tells = needs_.tells || action.kind == ActionKind::kAlert ||
                   action.kind == ActionKind::kTrigger || action.kind == ActionKind::kCrash;
    std::vector<const EvalNode*> args;
    for (const TypedExpr& arg : action.args) {
      RIPS_ASSIGN_OR_RETURN(const EvalNode* node, Expr(arg));
      out_->arguments.emplace(&arg, node);
      args.push_back(node);
    }
    const auto is = [&](ValueType type) {
      return std::all_of(args.begin(), args.end(),
                         [&](const EvalNode* arg) { return SameType(arg->type, type); });
    };
    bool fits = true;
    switch (action.kind) {
      case lang::ActionKind::kAlert:
      case lang::ActionKind::kExec:
      case lang::ActionKind::kCrash:
        fits = !args.empty() && is(ValueType::kString);
        break;
      case lang::ActionKind::kSet:
        fits = args.size() == 1 && action.variable < rules_.variables.size() &&
               is(rules_.variables[action.variable].type);
        break;
      case lang::ActionKind::kTrigger:
        fits = args.size() == 1 && is(ValueType::kInt);
        if (fits && action.args[0].kind == TypedExpr::Kind::kVariable) {
          out_->holds_level[action.args[0].variable] = true;
        }
        break;
      case lang::ActionKind::kTrue:
      case lang::ActionKind::kFalse:
        break;
    }
    return fits ? absl::OkStatus() : IllTyped();
  }

  absl::StatusOr<const EvalNode*> Expr(const TypedExpr& expr) {
    EvalNode node;
    RIPS_RETURN_IF_ERROR(Fill(expr, node));
    if (node.function == nullptr) return IllTyped();
    out_->code.push_back(std::move(node));
    return &out_->code.back();
  }

  absl::Status Fill(const TypedExpr& expr, EvalNode& node) {
    switch (expr.kind) {
      case TypedExpr::Kind::kConstant:
        FillConstant(expr, node);
        return absl::OkStatus();
      case TypedExpr::Kind::kVariable:
        if (expr.variable >= rules_.variables.size()) {
          return absl::InvalidArgumentError("an unknown variable");
        }
        node.index = expr.variable;
        node.type = rules_.variables[expr.variable].type;
        node.function = VariableFunction(node.type);
        return absl::OkStatus();
      case TypedExpr::Kind::kPredefined:
        node.type = lang::PredefinedOf(expr.predefined).type;
        node.function = PredefinedFunction(expr.predefined);
        return absl::OkStatus();
      case TypedExpr::Kind::kUnary:
        return FillUnary(expr, node);
      case TypedExpr::Kind::kBinary:
        return FillBinary(expr, node);
      case TypedExpr::Kind::kCall:
        return FillCall(expr, node);
    }
    return IllTyped();
  }

  static void FillConstant(const TypedExpr& expr, EvalNode& node) {
    node.function = ConstantFunction();
    if (const auto* integer = std::get_if<int64_t>(&expr.constant)) {
      node.type = ValueType::kInt;
      node.constant.integer = *integer;
    } else if (const auto* real = std::get_if<double>(&expr.constant)) {
      node.type = ValueType::kFloat;
      node.constant.real = *real;
    } else if (const auto* truth = std::get_if<bool>(&expr.constant)) {
      node.type = ValueType::kBool;
      node.constant.truth = *truth;
    } else {
      node.type = ValueType::kString;
      node.constant.text = std::get<std::string>(expr.constant);
    }
  }

  absl::Status FillUnary(const TypedExpr& expr, EvalNode& node) {
    if (expr.args.size() != 1) return IllTyped();
    RIPS_ASSIGN_OR_RETURN(node.left, Expr(expr.args[0]));
    node.type = PlainType(node.left->type);
    node.function = UnaryFunction(expr.unary, node.left->type);
    return absl::OkStatus();
  }

  absl::Status FillBinary(const TypedExpr& expr, EvalNode& node) {
    if (expr.args.size() != 2) return IllTyped();
    RIPS_ASSIGN_OR_RETURN(node.left, Expr(expr.args[0]));
    RIPS_ASSIGN_OR_RETURN(node.right, Expr(expr.args[1]));
    if (!SameType(node.left->type, node.right->type)) return IllTyped();
    const bool constant = IsConstant(node.right);
    if (constant) node.constant = node.right->constant;
    node.function = BinaryFunction(expr.binary, node.left->type, constant);
    const bool arithmetic = expr.binary >= BinaryOp::kAdd || expr.binary == BinaryOp::kBitOr ||
                            expr.binary == BinaryOp::kBitXor || expr.binary == BinaryOp::kBitAnd;
    node.type = arithmetic ? PlainType(node.left->type) : ValueType::kBool;
    return absl::OkStatus();
  }

  absl::Status FillCall(const TypedExpr& expr, EvalNode& node) {
    node.builtin = expr.builtin;
    node.type = lang::SignatureOf(expr.builtin).result;
    for (const TypedExpr& arg : expr.args) {
      RIPS_ASSIGN_OR_RETURN(const EvalNode* compiled, Expr(arg));
      node.args.push_back(compiled);
    }
    if (expr.builtin == Builtin::kTopicMatches) {
      const bool one = node.args.size() == 1 && IsConstant(node.args[0]) &&
                       node.args[0]->type == ValueType::kString;
      if (!one) return absl::InvalidArgumentError("`topicmatches` takes one constant string");
      return FillPredicate(expr, node);
    }
    node.function = CallFunction(expr.builtin, node.args);
    if (node.function == nullptr) return IllTyped();
    if (QuestionOf(expr.builtin) != nullptr) {
      const bool constant = std::all_of(node.args.begin(), node.args.end(), IsConstant);
      return constant ? FillPredicate(expr, node) : absl::OkStatus();
    }
    return NoteNeeds(expr, node);
  }

  absl::Status NoteNeeds(const TypedExpr& expr, EvalNode& node) {
    if (expr.builtin == Builtin::kPayload || expr.builtin == Builtin::kPlugin) {
      if (expr.inspection >= rules_.inspections.size()) return IllTyped();
      node.index = expr.inspection;
      needs_.inspects = true;
      if (in_arguments_) needs_.argument_inspections.push_back(expr.inspection);
    } else if (expr.builtin == Builtin::kMsgCount || expr.builtin == Builtin::kSenderCount) {
      const EvalNode* window = node.args[0];
      if (!IsConstant(window) || window->constant.integer < 1 ||
          window->constant.integer > lang::kWindowMsMax) {
        return absl::InvalidArgumentError("a window that is not constant or out of range");
      }
      node.index = window->constant.integer * kNanosPerMilli;
      int64_t& longest =
          expr.builtin == Builtin::kMsgCount ? needs_.topic_window_ns : needs_.sender_window_ns;
      longest = std::max(longest, node.index);
    }
    return absl::OkStatus();
  }

  absl::Status FillPredicate(const TypedExpr& expr, EvalNode& node) {
    Predicate predicate{.builtin = expr.builtin};
    for (const EvalNode* arg : node.args) {
      predicate.args.push_back(ToScalar(arg->constant, arg->type));
    }
    const Source source = QuestionOf(expr.builtin)->source;
    std::vector<Predicate>& list = source == Source::kTopic   ? out_->predicates
                                   : source == Source::kFacts ? out_->facts
                                                              : out_->graph;
    node.function = source == Source::kTopic   ? TopicPredicateFunction()
                    : source == Source::kFacts ? FactsPredicateFunction()
                                               : GraphPredicateFunction();
    std::unique_ptr<const RE2> regex;
    if (expr.builtin == Builtin::kTopicMatches && !IsKnown(predicate)) {
      RIPS_ASSIGN_OR_RETURN(regex, CompilePattern(node.args[0]->constant.text));
    }
    const auto [known, added] =
        known_.emplace(KeyOf(predicate), static_cast<uint32_t>(list.size()));
    node.index = known->second;
    if (source == Source::kTopic) out_->predicate_of.emplace(&expr, known->second);
    if (!added) return absl::OkStatus();
    if (regex != nullptr) {
      out_->patterns.Add(node.args[0]->constant.text, known->second);
      predicate.regex = std::move(regex);
    }
    list.push_back(std::move(predicate));
    return absl::OkStatus();
  }

  bool IsKnown(const Predicate& predicate) const { return known_.contains(KeyOf(predicate)); }

  const lang::CheckedRules& rules_;
  std::unique_ptr<CompiledPolicy::Compiled> out_ = std::make_unique<CompiledPolicy::Compiled>();
  absl::flat_hash_map<std::string, uint32_t> known_;
  RuleNeeds needs_;
  bool in_arguments_ = false;
};

}  // namespace

absl::StatusOr<std::shared_ptr<const CompiledPolicy>> CompiledPolicy::Create(
    lang::CheckedRules rules, CompiledPolicyOptions options) {
  std::shared_ptr<CompiledPolicy> program(new CompiledPolicy(std::move(rules), options));
  // What is compiled views the rules where they now stand.
  RIPS_ASSIGN_OR_RETURN(program->compiled_, Compiler(program->rules_).Run());
  return program;
}

}  // namespace rips::engine
