#include "policy_server/policy/lang/check/checker.h"

#include <algorithm>
#include <string>
#include <utility>

#include "absl/container/btree_set.h"
#include "absl/container/flat_hash_set.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "policy_server/policy/lang/check/expr_checker.h"
#include "policy_server/policy/lang/check/lowering.h"
#include "policy_server/policy/lang/check/scope.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/check/type.h"
#include "policy_server/policy/lang/check/usage.h"
#include "policy_server/policy/lang/limits.h"
#include "services/text/nearest.h"
#include "services/text/quote.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

constexpr size_t kRuleNameBytesMax = kIdentifierBytesMax;

bool HoldsControls(absl::string_view text) {
  for (size_t offset = 0; offset < text.size();) {
    const CodePoint point = DecodeCodePoint(text, offset);
    if (!point.valid || IsControl(point.value)) return true;
    offset += point.length;
  }
  return false;
}

// The first leaf that keeps `expr` from being constant.
const TypedExpr& FirstNotConstant(const TypedExpr& expr) {
  if (expr.kind == TypedExpr::Kind::kUnary || expr.kind == TypedExpr::Kind::kBinary) {
    for (const TypedExpr& arg : expr.args) {
      const TypedExpr& found = FirstNotConstant(arg);
      if (!found.is_constant()) return found;
    }
  }
  return expr;
}

class Checker {
 public:
  Checker(const CheckInput& input, DiagnosticSink& sink)
      : syntax_(input.syntax),
        sink_(sink),
        scope_(sink),
        exprs_(scope_, levels_, input.dialect, input.paths, input.inspection_files, usage_, sink) {
    out_.dialect = input.dialect;
  }

  CheckedRules Run(const std::vector<ast::File>& files) {
    for (const ast::File& file : files) {
      for (const ast::Section& section : file.sections) ExpectNames(section);
    }
    for (const ast::File& file : files) {
      for (const ast::Section& section : file.sections) CheckSection(section);
    }
    usage_.ReportBadTriggers(out_.variables, sink_);
    out_.levels = levels::LevelTable(levels_);
    if (syntax_ == Syntax::kClean && !sink_.has_errors() && !out_.rules.empty()) {
      usage_.ReportUnused(out_.variables, out_.levels, sink_);
      if (!sink_.has_errors()) WarnLowerings(out_, usage_.LevelsOfVariables(), sink_);
    }
    out_.inspections = exprs_.inspections();
    out_.programs.assign(programs_.begin(), programs_.end());
    return std::move(out_);
  }

 private:
  void ExpectNames(const ast::Section& section) {
    for (const ast::LevelDecl& level : section.levels) scope_.ExpectLater(level.name.text);
    for (const ast::Decl& decl : section.decls) scope_.ExpectLater(decl.name.text);
  }

  void CheckSection(const ast::Section& section) {
    switch (section.kind) {
      case ast::Section::Kind::kLevels:
        if (section.levels.empty() && syntax_ == Syntax::kBroken) levels_unread_ = true;
        for (const ast::LevelDecl& level : section.levels) CheckLevel(level);
        return;
      case ast::Section::Kind::kConsts:
        for (const ast::Decl& decl : section.decls) CheckConst(decl);
        return;
      case ast::Section::Kind::kVars:
        for (const ast::Decl& decl : section.decls) CheckVar(decl);
        return;
      case ast::Section::Kind::kRules:
        CheckRules(section);
        return;
    }
  }

  // --- Declarations.
  void CheckLevel(const ast::LevelDecl& level) {
    Symbol symbol;
    symbol.kind = Symbol::Kind::kConstant;
    symbol.type = ValueType::kLevel;
    symbol.value = static_cast<int64_t>(levels_.size());
    const bool fits = levels_.size() < kLevelsMax;
    if (!fits) symbol.kind = Symbol::Kind::kBroken;
    if (!scope_.Declare(level.name, std::move(symbol))) return;
    if (!fits) {
      ReportLimitOnce(DiagnosticKind::kTooManyLevels, level.name.range, "levels", kLevelsMax);
      return;
    }
    levels_.push_back({.name = level.name.text, .soft = level.soft});
    usage_.DeclareLevel(level.name.range);
  }

  void CheckConst(const ast::Decl& decl) {
    if (decl.is_set) return CheckSet(decl);
    Symbol symbol;
    const std::optional<TypedExpr> value = CheckInitialiser(decl);
    if (value) {
      symbol.kind = Symbol::Kind::kConstant;
      symbol.type = value->type;
      symbol.value = value->constant;
    }
    scope_.Declare(decl.name, std::move(symbol));
  }

  void CheckSet(const ast::Decl& decl) {
    Symbol symbol;
    if (!decl.broken) {
      if (decl.type.text != "string") {
        sink_.Add(DiagnosticKind::kUnknownType, decl.type.range,
                  absl::StrCat("a set of ", Quote(decl.type.text), " is not known"),
                  "sets are `set string`");
      }
      symbol.kind = Symbol::Kind::kSet;
      std::vector<TypedExpr> members;
      exprs_.CheckStringList(decl.values, 0, decl.name.text, {}, members);
      for (const TypedExpr& member : members) {
        if (!CheckConstant(member)) continue;
        if (const auto* text = std::get_if<std::string>(&member.constant)) {
          symbol.members.push_back(*text);
        }
      }
    }
    scope_.Declare(decl.name, std::move(symbol));
  }

  void CheckVar(const ast::Decl& decl) {
    Symbol symbol;
    if (decl.is_set) {
      sink_.Add(DiagnosticKind::kSetVariable, decl.name.range,
                absl::StrCat(Quote(decl.name.text), " cannot be a set: variables are not"),
                "declare the set under `consts:`");
      scope_.Declare(decl.name, std::move(symbol));
      return;
    }
    const std::optional<TypedExpr> value = CheckInitialiser(decl);
    if (!value) {
      scope_.Declare(decl.name, std::move(symbol));
      return;
    }
    symbol.kind = Symbol::Kind::kVariable;
    symbol.type = *TypeNamed(decl.type.text);
    symbol.variable = static_cast<uint32_t>(out_.variables.size());
    const ValueType type = symbol.type;
    if (!scope_.Declare(decl.name, std::move(symbol))) return;
    if (out_.variables.size() == kVariablesMax) {
      ReportLimitOnce(DiagnosticKind::kTooManyVariables, decl.name.range, "variables",
                      kVariablesMax);
    }
    out_.variables.push_back({.name = decl.name.text, .type = type, .initial = value->constant});
    usage_.DeclareVariable(decl.name.range, *value);
  }

  // A constant of the declared type; a level keeps its type.
  std::optional<TypedExpr> CheckInitialiser(const ast::Decl& decl) {
    if (decl.broken) return std::nullopt;
    const std::optional<ValueType> type = TypeNamed(decl.type.text);
    if (!type) {
      sink_.Add(DiagnosticKind::kUnknownType, decl.type.range,
                absl::StrCat("unknown type ", Quote(decl.type.text)),
                "types are `int`, `float`, `bool` and `string`");
    }
    std::optional<TypedExpr> value = exprs_.Check(decl.values[0], {});
    if (!value || !CheckConstant(*value) || !type) return std::nullopt;
    if (!Converts(value->type, *type)) {
      sink_.Add(DiagnosticKind::kTypeMismatch, value->range,
                absl::StrCat(Quote(decl.name.text), " is ", Quote(Name(*type)), "; this is ",
                             Quote(Name(value->type))));
      return std::nullopt;
    }
    return value;
  }

  bool CheckConstant(const TypedExpr& value) {
    if (value.is_constant()) return true;
    sink_.Add(DiagnosticKind::kNotConstant, FirstNotConstant(value).range,
              "an initialiser must be constant", "this is known only when a rule runs");
    return false;
  }

  void ReportLimitOnce(DiagnosticKind kind, SourceRange range, absl::string_view what,
                       size_t limit) {
    if (!limits_reported_.insert(kind).second) return;
    sink_.Add(kind, range, absl::StrCat("too many ", what, "; a policy has at most ", limit));
  }

  // --- Rules.
  void CheckRules(const ast::Section& section) {
    ExprContext context;
    context.section_name = section.event_type.text;
    context.section = SectionNamed(section.event_type.text);
    if (!context.section && !section.event_type.text.empty()) {
      sink_.Add(DiagnosticKind::kUnknownEventType, section.event_type.range,
                absl::StrCat("unknown event type ", Quote(section.event_type.text)),
                "event types are `Msg`, `Graph` and `External`");
    }
    if (levels_.empty() && !levels_unread_) {
      sink_.Add(DiagnosticKind::kNoLevels, section.keyword, "no level is declared before the rules",
                "declare at least one, as in `levels: DEFAULT;`");
      levels_unread_ = true;  // Once is enough.
    }
    for (size_t i = 0; i < section.rules.size(); ++i) {
      if (sink_.Full(section.keyword.file)) break;
      const std::string automatic = absl::StrFormat("sect_%05d:rule_%05d", section_count_, i);
      CheckRule(section.rules[i], automatic, context);
    }
    ++section_count_;
  }

  void CheckRule(const ast::Rule& rule, const std::string& automatic, ExprContext context) {
    TypedRule out;
    out.name = automatic;
    out.range = rule.range;
    out.section = context.section.value_or(EventClass::kMsg);
    if (rule.name) {
      CheckRuleName(*rule.name);
      out.name = rule.name->text;
    }
    if (rule.condition) {
      context.condition = true;
      std::optional<TypedExpr> condition = exprs_.Check(*rule.condition, context);
      context.condition = false;
      if (condition && condition->type != ValueType::kBool) {
        sink_.Add(DiagnosticKind::kTypeMismatch, condition->range,
                  absl::StrCat("the expression of a rule is `bool`; this is ",
                               Quote(Name(condition->type))));
      }
      if (condition) out.condition = std::move(*condition);
    }
    for (const ast::Chain& chain : rule.chains) {
      TypedChain typed;
      for (const ast::Action& action : chain) typed.push_back(CheckAction(action, context));
      out.chains.push_back(std::move(typed));
    }
    if (out_.rules.size() == kRulesMax) {
      ReportLimitOnce(DiagnosticKind::kTooManyRules, rule.range, "rules", kRulesMax);
      return;
    }
    out_.rules.push_back(std::move(out));
  }

  void CheckRuleName(const ast::Name& name) {
    std::string why;
    if (name.text.empty()) why = "is empty";
    if (name.text.size() > kRuleNameBytesMax) {
      why = absl::StrCat("has ", name.text.size(), " bytes, limit ", kRuleNameBytesMax);
    }
    if (HoldsControls(name.text)) why = "holds control characters or bad bytes";
    if (absl::StartsWith(name.text, "sect_") && absl::StrContains(name.text, ":rule_")) {
      why = "looks like the name of a rule without one";
    }
    if (!why.empty()) {
      sink_.Add(DiagnosticKind::kBadRuleName, name.range,
                absl::StrCat("rule name ", Quote(name.text), " ", why));
    } else if (!rule_names_.insert(name.text).second) {
      sink_.Add(DiagnosticKind::kDuplicateRuleName, name.range,
                absl::StrCat("two rules are called ", Quote(name.text)),
                "records name rules; give each its own name");
    }
  }

  // --- Actions. What is returned for a wrong one does not matter.
  TypedAction CheckAction(const ast::Action& action, const ExprContext& context) {
    TypedAction out;
    out.range = action.range;
    out.next = action.next;
    const ActionSignature* signature = FindAction(action.name.text);
    if (signature == nullptr) {
      ReportNotAnAction(action.name);
      return out;
    }
    out.kind = signature->action;
    const int given = static_cast<int>(action.args.size());
    if (given < signature->args_min || (signature->args_max >= 0 && given > signature->args_max)) {
      sink_.Add(DiagnosticKind::kArgumentCount, action.name.range,
                absl::StrCat(Quote(action.name.text), " does not take ", given,
                             given == 1 ? " argument" : " arguments"),
                absl::StrCat("it is called like `", signature->usage, "`"));
      return out;
    }
    switch (out.kind) {
      case ActionKind::kAlert:
        CheckAlert(action, context, out);
        break;
      case ActionKind::kSet:
        CheckSet(action, context, out);
        break;
      case ActionKind::kExec:
        CheckExec(action, context, out);
        break;
      case ActionKind::kTrigger:
        CheckTrigger(action, context, out);
        break;
      case ActionKind::kTrue:
      case ActionKind::kFalse:
        for (const ast::Expr& arg : action.args) {
          if (std::optional<TypedExpr> value = exprs_.Check(arg, context)) {
            out.args.push_back(std::move(*value));
          }
        }
        break;
      case ActionKind::kCrash:
        if (std::optional<TypedExpr> text =
                CheckString(action.args[0], "`text` of `crash`", context)) {
          out.args.push_back(std::move(*text));
        }
        break;
    }
    return out;
  }

  void ReportNotAnAction(const ast::Name& name) {
    const std::string quoted = Quote(name.text);
    if (FindSignature(name.text) != nullptr || FindPredefined(name.text) != nullptr ||
        scope_.Find(name.text) != nullptr) {
      sink_.Add(DiagnosticKind::kExpressionInChain, name.range,
                absl::StrCat(quoted, " is not an action; it cannot stand in a chain"),
                "expressions stand before the `?`");
      return;
    }
    std::vector<absl::string_view> known;
    for (const ActionSignature& action : ActionSignatures()) known.push_back(action.name);
    sink_.Add(DiagnosticKind::kUnknownName, name.range, absl::StrCat("unknown action ", quoted),
              NearestHint(name.text, known));
  }

  // The argument, if it is well-typed and a string.
  std::optional<TypedExpr> CheckString(const ast::Expr& arg, absl::string_view what,
                                       const ExprContext& context) {
    std::optional<TypedExpr> out = exprs_.Check(arg, context);
    if (!out || out->type == ValueType::kString) return out;
    sink_.Add(DiagnosticKind::kTypeMismatch, out->range,
              absl::StrCat(what, " is `string`; this is ", Quote(Name(out->type))));
    return std::nullopt;
  }

  void CheckAlert(const ast::Action& action, const ExprContext& context, TypedAction& out) {
    std::optional<TypedExpr> text = CheckString(action.args[0], "`text` of `alert`", context);
    if (text) out.args.push_back(std::move(*text));
    if (action.args.size() == 1) return;
    std::optional<TypedExpr> severity =
        CheckString(action.args[1], "`severity` of `alert`", context);
    if (!severity) return;
    if (severity->is_constant()) {
      const std::string& word = std::get<std::string>(severity->constant);
      const auto known = Severities();
      if (std::find(known.begin(), known.end(), word) == known.end()) {
        sink_.Add(DiagnosticKind::kBadSeverity, severity->range,
                  absl::StrCat("unknown severity ", Quote(word)),
                  "severities are `info`, `low`, `medium`, `high` and `critical`");
      }
    }
    out.args.push_back(std::move(*severity));
  }

  void CheckSet(const ast::Action& action, const ExprContext& context, TypedAction& out) {
    const ast::Expr& target = action.args[0];
    const Symbol* symbol = nullptr;
    if (target.kind == ast::Expr::Kind::kName) symbol = scope_.Find(target.text);
    if (symbol == nullptr || symbol->kind != Symbol::Kind::kVariable) {
      ReportNotAssignable(target, symbol);
      exprs_.Check(action.args[1], context);
      return;
    }
    ExprContext value_context = context;
    value_context.set_target = symbol->variable;
    std::optional<TypedExpr> value = exprs_.Check(action.args[1], value_context);
    if (!value) return;
    if (!Converts(value->type, symbol->type)) {
      sink_.Add(DiagnosticKind::kTypeMismatch, value->range,
                absl::StrCat("variable ", Quote(target.text), " is ", Quote(Name(symbol->type)),
                             "; this is ", Quote(Name(value->type))));
      return;
    }
    const bool itself =
        value->kind == TypedExpr::Kind::kVariable && value->variable == symbol->variable;
    if (itself) usage_.Read(symbol->variable);
    usage_.Set(symbol->variable, *value);
    out.variable = symbol->variable;
    out.args.push_back(std::move(*value));
  }

  void ReportNotAssignable(const ast::Expr& target, const Symbol* symbol) {
    if (target.kind != ast::Expr::Kind::kName) {
      sink_.Add(DiagnosticKind::kNotAssignable, target.range,
                "`set` assigns to a variable; this is not the name of one");
      return;
    }
    const std::string quoted = Quote(target.text);
    const bool predefined = symbol == nullptr && FindPredefined(target.text) != nullptr;
    if (predefined || (symbol != nullptr && symbol->kind != Symbol::Kind::kBroken)) {
      sink_.Add(DiagnosticKind::kNotAssignable, target.range,
                absl::StrCat(quoted, predefined ? " is predefined" : " is a constant",
                             "; it cannot be set"));
    } else if (symbol == nullptr) {
      // For the same words as anywhere else.
      exprs_.Check(target, {});
    }
  }

  void CheckExec(const ast::Action& action, const ExprContext& context, TypedAction& out) {
    std::optional<TypedExpr> program = CheckString(action.args[0], "`program` of `exec`", context);
    if (program && !program->is_constant()) {
      sink_.Add(DiagnosticKind::kBadProgram, program->range,
                "the program of `exec` must be constant",
                "robots run only programs that are known beforehand; pass what varies as argument");
      program.reset();
    }
    if (program) {
      const std::string& name = std::get<std::string>(program->constant);
      if (name.empty() || name.find('\0') != std::string::npos) {
        sink_.Add(DiagnosticKind::kBadProgram, program->range,
                  "the program of `exec` is empty or holds a zero byte");
      }
      programs_.insert(name);
      out.args.push_back(std::move(*program));
    }
    exprs_.CheckStringList(action.args, 1, "exec", context, out.args);
  }

  void CheckTrigger(const ast::Action& action, const ExprContext& context, TypedAction& out) {
    std::optional<TypedExpr> level = exprs_.Check(action.args[0], context);
    if (!level) return;
    if (level->kind == TypedExpr::Kind::kVariable && level->type == ValueType::kInt) {
      usage_.TriggerVariable(level->variable, level->range);
    } else if (level->type != ValueType::kLevel) {
      std::string hint = "its argument is a level name, `CurrLevel` or a variable that holds one";
      if (level->is_constant() && level->type == ValueType::kString) {
        hint = "levels are written without quotes";
      }
      sink_.Add(DiagnosticKind::kBadTriggerLevel, level->range,
                absl::StrCat("`trigger` takes a level; this is ", Quote(Name(level->type))),
                std::move(hint));
      return;
    } else if (level->is_constant()) {
      usage_.Trigger(static_cast<int>(std::get<int64_t>(level->constant)));
    }
    out.args.push_back(std::move(*level));
  }

  Syntax syntax_;
  DiagnosticSink& sink_;
  CheckedRules out_;
  std::vector<levels::Level> levels_;
  Usage usage_;
  Scope scope_;
  ExprChecker exprs_;
  bool levels_unread_ = false;
  int section_count_ = 0;
  absl::flat_hash_set<std::string> rule_names_;
  absl::btree_set<std::string> programs_;
  absl::flat_hash_set<DiagnosticKind> limits_reported_;
};

}  // namespace

CheckedRules Check(const CheckInput& input, DiagnosticSink& sink) {
  return Checker(input, sink).Run(input.files);
}

}  // namespace rips::lang
