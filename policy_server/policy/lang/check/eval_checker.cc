// What calls name by a string: variables and values of `eval`, files of `payload`, plugins. The
// part of ExprChecker that reads inside strings.
#include <algorithm>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "policy_server/policy/lang/check/expr_checker.h"
#include "policy_server/policy/lang/check/type.h"
#include "policy_server/policy/lang/limits.h"
#include "policy_server/policy/lang/syntax/lexer.h"
#include "policy_server/policy/lang/syntax/literal.h"
#include "policy_server/policy/lang/syntax/operators.h"
#include "policy_server/policy/lang/syntax/parser.h"
#include "services/text/quote.h"

namespace rips::lang {
namespace {

constexpr BinaryOp kComparisons[] = {BinaryOp::kEq, BinaryOp::kNe, BinaryOp::kLt,
                                     BinaryOp::kLe, BinaryOp::kGt, BinaryOp::kGe};

// `name` seen from the directory of `file`, without `.` and inner `..`.
std::string PathFrom(absl::string_view file, absl::string_view name) {
  std::string path(name);
  const size_t slash = file.rfind('/');
  if (!absl::StartsWith(name, "/") && slash != absl::string_view::npos) {
    path = absl::StrCat(file.substr(0, slash + 1), name);
  }
  std::vector<absl::string_view> parts;
  for (const absl::string_view part : absl::StrSplit(path, '/')) {
    if (part.empty() || part == ".") continue;
    if (part == ".." && !parts.empty() && parts.back() != "..") {
      parts.pop_back();
    } else {
      parts.push_back(part);
    }
  }
  return absl::StrCat(absl::StartsWith(path, "/") ? "/" : "", absl::StrJoin(parts, "/"));
}

bool IsPluginId(absl::string_view id) {
  return !id.empty() && id.size() <= kPluginIdBytesMax && id[0] != '-' &&
         std::all_of(id.begin(), id.end(),
                     [](char c) { return absl::ascii_isalnum(c) || c == '_' || c == '-'; });
}

DiagnosticKind KindOf(InspectionProblem::Kind kind) {
  switch (kind) {
    case InspectionProblem::Kind::kMissing:
      return DiagnosticKind::kMissingInspection;
    case InspectionProblem::Kind::kBroken:
      return DiagnosticKind::kBrokenInspection;
    case InspectionProblem::Kind::kSlow:
      return DiagnosticKind::kSlowInspection;
  }
  return DiagnosticKind::kBrokenInspection;
}

// A literal of a number or bool and nothing else, or none.
std::optional<ast::Expr> ParseLiteral(const std::string& text, SourceRange range) {
  const Source source(range.file, text);
  DiagnosticSink sink;
  std::optional<ast::Expr> out = ParseExpression(source, Lex(source, sink), sink);
  if (!out || sink.has_errors()) return std::nullopt;
  ast::Expr* leaf = &*out;
  while (leaf->kind == ast::Expr::Kind::kUnary && !leaf->parenthesized &&
         (leaf->unary == UnaryOp::kMinus || leaf->unary == UnaryOp::kPlus)) {
    leaf->range = range;
    leaf = &leaf->operands[0];
  }
  leaf->range = range;
  if (leaf->parenthesized) return std::nullopt;
  return out;
}

}  // namespace

std::optional<ExprChecker::Checked> ExprChecker::CheckEval(const ast::Expr& call,
                                                           const ExprContext& context) {
  const bool three_strings =
      call.operands.size() == 3 &&
      std::all_of(call.operands.begin(), call.operands.end(),
                  [](const ast::Expr& arg) { return arg.kind == ast::Expr::Kind::kString; });
  if (!three_strings) {
    sink_.Add(DiagnosticKind::kBadEval, call.range, "`eval` takes three string literals",
              "it is called like `eval(\"x\", \"<\", \"10\")`; without quotes, write `x < 10`");
    return std::nullopt;
  }
  const auto* const op = std::find_if(
      std::begin(kComparisons), std::end(kComparisons),
      [&](BinaryOp candidate) { return call.operands[1].text == Spelling(candidate); });
  if (op == std::end(kComparisons)) {
    sink_.Add(DiagnosticKind::kBadEval, call.operands[1].range,
              absl::StrCat(Quote(call.operands[1].text), " is not a comparison"),
              "`eval` knows `==`, `!=`, `<`, `<=`, `>` and `>=`");
    return std::nullopt;
  }
  ast::Expr variable;
  variable.kind = ast::Expr::Kind::kName;
  variable.range = call.operands[0].range;
  variable.text = call.operands[0].text;
  const std::optional<Checked> left = CheckExpr(variable, context);
  if (!left) return std::nullopt;
  std::optional<ast::Expr> value = EvalOperand(call.operands[2], variable, left->typed.type);
  if (!value) return std::nullopt;
  ast::Expr run;
  run.kind = ast::Expr::Kind::kRun;
  run.range = call.range;
  run.operands.push_back(std::move(variable));
  run.operands.push_back(*std::move(value));
  run.operators.push_back({.op = *op, .range = call.operands[1].range});
  return CheckRun(run, context);
}

std::optional<ast::Expr> ExprChecker::EvalOperand(const ast::Expr& text, const ast::Expr& variable,
                                                  ValueType type) {
  ast::Expr value = text;
  if (type == ValueType::kString) return value;
  if (type == ValueType::kLevel) {
    value.kind = ast::Expr::Kind::kName;
    const Symbol* symbol = scope_.Find(text.text);
    if (symbol != nullptr && symbol->kind == Symbol::Kind::kConstant &&
        symbol->type == ValueType::kLevel) {
      return value;
    }
  } else {
    std::optional<ast::Expr> literal = ParseLiteral(text.text, text.range);
    const ast::Expr* leaf = literal ? &*literal : nullptr;
    while (leaf != nullptr && leaf->kind == ast::Expr::Kind::kUnary) leaf = &leaf->operands[0];
    const bool fits =
        leaf != nullptr &&
        ((type == ValueType::kInt && leaf->kind == ast::Expr::Kind::kInteger) ||
         (type == ValueType::kFloat && leaf->kind == ast::Expr::Kind::kFloat) ||
         (type == ValueType::kBool && leaf == &*literal && leaf->kind == ast::Expr::Kind::kBool));
    if (fits) return literal;
  }
  sink_.Add(DiagnosticKind::kBadEval, text.range,
            absl::StrCat(Quote(text.text), " is not a value of ", Quote(variable.text),
                         ", which is ", Quote(Name(type))),
            type == ValueType::kLevel ? "write the name of a level" : "");
  return std::nullopt;
}

bool ExprChecker::CheckInspection(const TypedExpr& arg, Inspection::Kind kind, uint32_t& index) {
  const bool is_file = kind == Inspection::Kind::kPayload;
  if (!arg.is_constant()) {
    sink_.Add(
        DiagnosticKind::kNotConstant, arg.range,
        is_file ? "the file of `payload` must be constant" : "the id of `plugin` must be constant",
        "it is loaded with the policy");
    return false;
  }
  const std::string& name = std::get<std::string>(arg.constant);
  if (is_file ? name.empty() || name.find('\0') != std::string::npos : !IsPluginId(name)) {
    sink_.Add(DiagnosticKind::kBadInspectionName, arg.range,
              absl::StrCat(Quote(name), is_file ? " is not a path" : " is not the id of a plugin"),
              is_file ? ""
                      : absl::StrCat("an id has 1 to ", kPluginIdBytesMax,
                                     " letters, digits, `_` and `-`"));
    return false;
  }
  const absl::string_view rule_file =
      arg.range.file < paths_.size() ? absl::string_view(paths_[arg.range.file]) : "";
  Inspection inspection = {
      .kind = kind,
      .name = name,
      .path = PathFrom(rule_file, is_file ? name : absl::StrCat("plugins/", name))};
  const std::optional<uint32_t> added = AddInspection(std::move(inspection), arg.range);
  if (!added) return false;
  index = *added;
  return true;
}

std::optional<uint32_t> ExprChecker::AddInspection(Inspection inspection, SourceRange range) {
  const auto known =
      std::find_if(inspections_.begin(), inspections_.end(), [&](const Inspection& other) {
        return other.kind == inspection.kind && other.path == inspection.path;
      });
  // What is wrong with it was said at its first use.
  if (known != inspections_.end()) return static_cast<uint32_t>(known - inspections_.begin());
  if (inspections_.size() == kInspectionsMax) {
    sink_.Add(
        DiagnosticKind::kTooManyInspections, range,
        absl::StrCat("too many YARA files and plugins; a policy has at most ", kInspectionsMax));
    return std::nullopt;
  }
  inspections_.push_back(inspection);
  if (files_ != nullptr) {
    for (const InspectionProblem& problem : files_->Check(inspection)) {
      const bool missing = problem.kind == InspectionProblem::Kind::kMissing;
      sink_.Add(KindOf(problem.kind), range, problem.message,
                missing ? "it is looked for from the directory of the rule file" : "");
    }
  }
  return static_cast<uint32_t>(inspections_.size() - 1);
}

}  // namespace rips::lang
