// The calls among expressions: the part of ExprChecker that reads the table of builtins.
#include <algorithm>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/lang/check/expr_checker.h"
#include "policy_server/policy/lang/check/type.h"
#include "policy_server/policy/lang/limits.h"
#include "policy_server/policy/lang/value_text.h"
#include "re2/re2.h"
#include "services/text/nearest.h"
#include "services/text/quote.h"

namespace rips::lang {
namespace {

// A call that is false for every event, by its arguments alone: a range without numbers, a list
// without members.
bool NeverTrue(const Signature& signature, const std::vector<TypedExpr>& args) {
  if (signature.builtin == Builtin::kTopicIn || signature.builtin == Builtin::kMsgTypeIn ||
      signature.builtin == Builtin::kSenderIn || signature.builtin == Builtin::kSenderEnclave) {
    return args.empty();
  }
  for (size_t i = 1; i < std::min(signature.parameters.size(), args.size()); ++i) {
    if (signature.parameters[i].role != ParameterRole::kRangeMax || !args[i].is_constant())
      continue;
    const int64_t max = std::get<int64_t>(args[i].constant);
    if (max < 0) return true;
    if (args[i - 1].is_constant() && std::get<int64_t>(args[i - 1].constant) > max) return true;
  }
  return false;
}

absl::string_view Subject(EventClass event_class) {
  switch (event_class) {
    case EventClass::kUniversal:
      return "any event";
    case EventClass::kMsg:
      return "a message";
    case EventClass::kGraph:
      return "the graph";
    case EventClass::kExternal:
      return "an external event";
  }
  return "";
}

absl::string_view SectionsFor(EventClass event_class) {
  switch (event_class) {
    case EventClass::kUniversal:
      return "any section";
    case EventClass::kMsg:
      return "a `rules Msg` section";
    case EventClass::kGraph:
      return "a `rules Graph` or `rules Msg` section";
    case EventClass::kExternal:
      return "a `rules External` section";
  }
  return "";
}

// It may be not known on a live robot: an action with it fails then, and a variable would go on
// saying what was so before. And a kind that there is not never stands.
bool CheckFindingStands(const ast::Expr& expr, const TypedExpr& kind, const ExprContext& context,
                        DiagnosticSink& sink) {
  if (!context.condition && context.section) {
    sink.Add(DiagnosticKind::kAskedInAction, expr.range,
             "`findingstands` is asked in the expression of a rule, not in an action",
             "while it is not known the action would fail; write "
             "`findingstands(\"any\") ? set(found, true);`");
    return false;
  }
  if (kind.is_constant()) return true;
  sink.Add(DiagnosticKind::kNotConstant, kind.range, "the kind of `findingstands` must be constant",
           "what is no kind would never stand");
  return false;
}

}  // namespace

std::optional<ExprChecker::Checked> ExprChecker::CheckCall(const ast::Expr& expr,
                                                           const ExprContext& context) {
  const Symbol* symbol = scope_.Find(expr.text);
  const Signature* signature = symbol == nullptr ? FindSignature(expr.text) : nullptr;
  if (signature == nullptr) {
    if (symbol == nullptr || symbol->kind != Symbol::Kind::kBroken) ReportNotCallable(expr);
    // For the mistakes in them.
    for (const ast::Expr& arg : expr.operands) {
      const Symbol* set = arg.kind == ast::Expr::Kind::kName ? scope_.Find(arg.text) : nullptr;
      if (set == nullptr || set->kind != Symbol::Kind::kSet) CheckExpr(arg, context);
    }
    return std::nullopt;
  }
  if (signature->builtin == Builtin::kEval) return CheckEval(expr, context);
  CheckClass(expr.text, expr.name, signature->event_class, context);
  std::optional<std::vector<Checked>> args = CheckArgs(expr, *signature, context);
  if (!args) return std::nullopt;
  if (signature->builtin == Builtin::kFindingStands &&
      !CheckFindingStands(expr, (*args)[0].typed, context, sink_)) {
    return std::nullopt;
  }
  NoteDialect(expr, *signature);

  Checked out;
  out.typed.kind = TypedExpr::Kind::kCall;
  out.typed.type = signature->result;
  out.typed.range = expr.range;
  out.typed.builtin = signature->builtin;
  const Builtin builtin = signature->builtin;
  if (builtin == Builtin::kPayload || builtin == Builtin::kPlugin) {
    const auto kind =
        builtin == Builtin::kPayload ? Inspection::Kind::kPayload : Inspection::Kind::kPlugin;
    if (!CheckInspection((*args)[0].typed, kind, out.typed.inspection)) return std::nullopt;
    args->clear();
  }
  out.typed.args.reserve(args->size());
  for (size_t i = 0; i < args->size(); ++i) {
    if (i < expr.operands.size()) WarnDecided(expr.operands[i], (*args)[i], context);
    out.depth = std::max(out.depth, (*args)[i].depth + 1);
    out.typed.args.push_back(std::move((*args)[i].typed));
  }
  if (NeverTrue(*signature, out.typed.args)) out.truth.may_be_true = false;
  const bool inspected = std::any_of(args->begin(), args->end(),
                                     [](const Checked& arg) { return arg.reach.inspects; });
  out.reach = ReachOf(*signature);
  out.reach.inspects |= inspected;
  FoldCall(*signature, out);
  return out;
}

std::optional<std::vector<ExprChecker::Checked>> ExprChecker::CheckArgs(
    const ast::Expr& call, const Signature& signature, const ExprContext& context) {
  const size_t fixed = signature.parameters.size();
  const size_t given = call.operands.size();
  bool good = true;
  if (given < fixed || (given > fixed && !signature.variadic())) {
    sink_.Add(DiagnosticKind::kArgumentCount, call.name,
              absl::StrCat(Quote(call.text), " takes ", signature.variadic() ? "at least " : "",
                           fixed, fixed == 1 ? " argument, " : " arguments, ", given, " given"),
              absl::StrCat("it is called like `", UsageOf(signature), "`"));
    good = false;
  }
  std::vector<Checked> out;
  for (size_t i = 0; i < given && (i < fixed || !signature.variadic()); ++i) {
    std::optional<Checked> arg = CheckExpr(call.operands[i], context);
    good = good && arg.has_value();
    if (!arg || i >= fixed) continue;
    good = CheckArgument(arg->typed, signature.parameters[i], out, call.text) && good;
    out.push_back(std::move(*arg));
  }
  if (signature.variadic()) {
    const size_t listed = out.size();
    good = CheckList(call.operands, fixed, call.text, context, out) && good;
    for (size_t i = listed; i < out.size(); ++i) WarnName(out[i].typed, signature.list.role);
  }
  if (!good) return std::nullopt;
  return out;
}

bool ExprChecker::CheckList(const std::vector<ast::Expr>& list, size_t begin,
                            absl::string_view owner, const ExprContext& context,
                            std::vector<Checked>& out) {
  bool good = true;
  for (size_t i = begin; i < list.size(); ++i) {
    const ast::Expr& expr = list[i];
    const Symbol* set = expr.kind == ast::Expr::Kind::kName ? scope_.Find(expr.text) : nullptr;
    if (set != nullptr && set->kind == Symbol::Kind::kSet) {
      for (const std::string& member : set->members) {
        Checked item;
        item.typed.type = ValueType::kString;
        item.typed.constant = member;
        item.typed.range = expr.range;
        out.push_back(std::move(item));
      }
      continue;
    }
    std::optional<Checked> item = CheckExpr(expr, context);
    good = good && item.has_value();
    if (!item) continue;
    if (item->typed.type != ValueType::kString) {
      sink_.Add(DiagnosticKind::kTypeMismatch, item->typed.range,
                absl::StrCat(Quote(owner), " takes a list of strings; this is ",
                             Quote(Name(item->typed.type))));
      good = false;
    }
    out.push_back(std::move(*item));
  }
  return good;
}

bool ExprChecker::CheckArgument(const TypedExpr& arg, const Parameter& parameter,
                                const std::vector<Checked>& before, absl::string_view owner) {
  if (parameter.role == ParameterRole::kAnyType) return true;
  if (!Converts(arg.type, parameter.type)) {
    sink_.Add(DiagnosticKind::kTypeMismatch, arg.range,
              absl::StrCat("`", parameter.name, "` of ", Quote(owner), " is ",
                           Quote(Name(parameter.type)), "; this is ", Quote(Name(arg.type))));
    return false;
  }
  switch (parameter.role) {
    case ParameterRole::kRegex:
      return CheckRegex(arg);
    case ParameterRole::kWindow:
      return CheckWindow(arg);
    case ParameterRole::kWord:
      return CheckWord(arg, parameter, before, owner);
    default:
      WarnName(arg, parameter.role);
      return true;
  }
}

bool ExprChecker::CheckWord(const TypedExpr& arg, const Parameter& parameter,
                            const std::vector<Checked>& before, absl::string_view owner) {
  if (!arg.is_constant()) return true;
  std::span<const absl::string_view> words = parameter.words;
  if (words.empty()) {
    // It depends on the word before, which has been checked.
    if (before.empty() || !before.back().typed.is_constant()) return true;
    words = AgentStates(std::get<std::string>(before.back().typed.constant));
    if (words.empty()) return true;
  }
  const std::string& word = std::get<std::string>(arg.constant);
  if (std::find(words.begin(), words.end(), word) != words.end()) return true;
  sink_.Add(DiagnosticKind::kBadWord, arg.range,
            absl::StrCat(Quote(word), " means nothing to ", Quote(owner)),
            absl::StrCat("`", parameter.name, "` is one of `", absl::StrJoin(words, "`, `"), "`"));
  return false;
}

bool ExprChecker::CheckWindow(const TypedExpr& arg) {
  if (!arg.is_constant()) {
    sink_.Add(DiagnosticKind::kNotConstant, arg.range, "the window of a count must be constant",
              "the server keeps what the longest window of the policy needs");
    return false;
  }
  const int64_t window_ms = std::get<int64_t>(arg.constant);
  if (window_ms >= 1 && window_ms <= kWindowMsMax) return true;
  sink_.Add(DiagnosticKind::kBadWindow, arg.range,
            absl::StrCat("a window of ", window_ms, " ms; it is 1 to ", kWindowMsMax));
  return false;
}

ExprChecker::Reach ExprChecker::ReachOf(const Signature& signature) {
  static_assert(kBuiltinCount <= 64, "Reach::needs has a bit for each builtin");
  switch (signature.event_class) {
    case EventClass::kMsg:
      break;
    case EventClass::kExternal:
      return {.needs = uint64_t{1} << static_cast<int>(signature.builtin)};
    case EventClass::kGraph:
    case EventClass::kUniversal:
      return {};
  }
  Reach reach;
  for (const Parameter& parameter : signature.parameters) {
    reach.inspects |=
        parameter.role == ParameterRole::kYaraFile || parameter.role == ParameterRole::kPluginId;
  }
  reach.narrow =
      signature.builtin == Builtin::kTopicIn || signature.builtin == Builtin::kTopicMatches ||
      signature.builtin == Builtin::kMsgTypeIn || signature.builtin == Builtin::kMsgSubtype;
  return reach;
}

bool ExprChecker::CheckRegex(const TypedExpr& arg) {
  if (!arg.is_constant()) {
    sink_.Add(DiagnosticKind::kNotConstant, arg.range, "a regex must be constant");
    return false;
  }
  // Patterns can be slow to compile, so no more than what is needed for the answer.
  if (regex_instructions_ > kRegexInstructionsMax || sink_.Full(arg.range.file)) return false;
  const std::string& pattern = std::get<std::string>(arg.constant);
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(kRegexBytesMax);
  const RE2 regex(pattern, options);
  if (regex.ok()) {
    regex_instructions_ += static_cast<size_t>(regex.ProgramSize());
    if (regex_instructions_ <= kRegexInstructionsMax) return true;
    sink_.Add(DiagnosticKind::kRegexTooLarge, arg.range,
              absl::StrCat("with this one, the patterns of the policy exceed limit ",
                           kRegexInstructionsMax, " of RE2 instructions"),
              "simplify the patterns; counted repetitions and Unicode classes are large");
    return false;
  }
  // RE2 gave up on its size only after the work.
  if (regex.error_code() == RE2::ErrorPatternTooLarge) {
    regex_instructions_ += kRegexInstructionsMax / 10;
  }
  sink_.Add(DiagnosticKind::kBadRegex, arg.range, absl::StrCat("bad regex: ", regex.error()),
            "the syntax is RE2's");
  return false;
}

void ExprChecker::CheckClass(absl::string_view name, SourceRange range, EventClass of,
                             const ExprContext& context) {
  if (!context.section || Accepts(*context.section, of)) return;
  sink_.Add(DiagnosticKind::kClassMismatch, range,
            absl::StrCat(Quote(name), " is about ", Subject(of), "; it cannot be used in `rules ",
                         context.section_name, "`"),
            absl::StrCat("move the rule to ", SectionsFor(of)));
}

void ExprChecker::FoldCall(const Signature& signature, Checked& call) const {
  if (signature.event_class != EventClass::kUniversal || call.typed.args.empty() ||
      !call.typed.args[0].is_constant()) {
    return;
  }
  const Value& arg = call.typed.args[0].constant;
  std::string value;
  if (signature.builtin == Builtin::kString) {
    value = ToText(arg);
  } else if (signature.builtin == Builtin::kLevelName) {
    const int64_t index = std::get<int64_t>(arg);
    // A level of that number may be declared further on.
    if (index >= static_cast<int64_t>(levels_.size())) return;
    if (index >= 0) value = levels_[static_cast<size_t>(index)].name;
  } else {
    return;
  }
  call.typed.kind = TypedExpr::Kind::kConstant;
  call.typed.constant = std::move(value);
  call.typed.args.clear();
  call.depth = 1;
}

void ExprChecker::ReportNotCallable(const ast::Expr& call) {
  const std::string quoted = Quote(call.text);
  if (scope_.Find(call.text) != nullptr || FindPredefined(call.text) != nullptr) {
    sink_.Add(DiagnosticKind::kNotCallable, call.name,
              absl::StrCat(quoted, " is a value, not a builtin"),
              "write the name alone, without parentheses");
  } else if (FindAction(call.text) != nullptr) {
    sink_.Add(DiagnosticKind::kActionInExpression, call.name,
              absl::StrCat(quoted, " is an action; it cannot be used in an expression"),
              "actions stand after the `?`");
  } else if (!sink_.Full(call.name.file)) {
    std::vector<absl::string_view> known;
    for (const Signature& signature : Signatures()) known.push_back(signature.name);
    for (const ActionSignature& action : ActionSignatures()) known.push_back(action.name);
    sink_.Add(DiagnosticKind::kUnknownName, call.name, absl::StrCat("unknown builtin ", quoted),
              NearestHint(call.text, known));
  }
}

void ExprChecker::NoteDialect(const ast::Expr& call, const Signature& signature) {
  if (!signature.include_form || dialect_noted_) return;
  dialect_noted_ = true;
  const bool rips = dialect_ == CheckedRules::Dialect::kRips;
  sink_.Add(DiagnosticKind::kDialectChoice, call.name,
            absl::StrCat("dialect `", rips ? "rips" : "prototype", "`: ",
                         rips ? "`nodesinclude` and its like are true when the current ones are "
                                "all among the given"
                              : "`nodesinclude` and its like are true when the given are all "
                                "among the current ones, and `subscribersinclude` is inverted"),
            absl::StrCat("dialect `", rips ? "prototype" : "rips", "` reads them the other way"));
}

}  // namespace rips::lang
