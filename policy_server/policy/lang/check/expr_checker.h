// Gives an expression its types and folds its constants.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECK_EXPR_CHECKER_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECK_EXPR_CHECKER_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/policy/lang/check/scope.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/check/usage.h"
#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/policy/lang/diagnostic/diagnostic_sink.h"
#include "policy_server/policy/lang/inspection_files.h"
#include "policy_server/policy/lang/syntax/ast.h"

namespace rips::lang {

// Where an expression stands.
struct ExprContext {
  // The class of its section. None in an initialiser and in a section of unknown class.
  std::optional<EventClass> section;
  // As the file spells it, for messages.
  std::string section_name;
  // It decides whether a rule fires: parts that are always true or false get a warning.
  bool condition = false;
  // It is what this variable is set to. `set(x, x + 1)` alone does not count as reading `x`.
  std::optional<uint32_t> set_target;
};

class ExprChecker {
 public:
  // Nothing is owned; all outlive this. Levels declared later are taken into account. `files` may
  // be null: then files that rules name are not looked at.
  ExprChecker(const Scope& scope, const std::vector<levels::Level>& levels,
              CheckedRules::Dialect dialect, const std::vector<std::string>& paths,
              InspectionFiles* files, Usage& usage, DiagnosticSink& sink)
      : scope_(scope),
        levels_(levels),
        dialect_(dialect),
        paths_(paths),
        files_(files),
        usage_(usage),
        sink_(sink) {}

  // Of all calls of payload and plugin so far.
  const std::vector<Inspection>& inspections() const { return inspections_; }

  // None if the expression is wrong; that has been reported, all mistakes in it.
  std::optional<TypedExpr> Check(const ast::Expr& expr, const ExprContext& context);

  // A list of strings, list[begin] and what follows: expressions, and names of sets, which stand
  // for their members. Appended to `out`; wrong ones are reported. `owner` is whose list it is.
  void CheckStringList(const std::vector<ast::Expr>& list, size_t begin, absl::string_view owner,
                       const ExprContext& context, std::vector<TypedExpr>& out);

 private:
  // What values a bool expression may have, if it has one.
  struct Truth {
    bool may_be_true = true;
    bool may_be_false = true;

    bool decided() const { return may_be_true != may_be_false; }
  };
  // What is known of the events for which a bool expression is true or asked.
  struct Reach {
    // It is true only of messages on topics that it names, by name or by type.
    bool narrow = false;
    // It holds a call of payload or plugin.
    bool inspects = false;
    // External builtins that must be true for it to be true, one bit each.
    uint64_t needs = 0;
  };
  struct Checked {
    TypedExpr typed;
    Truth truth;
    Reach reach;
    int depth = 1;
  };

  std::optional<Checked> CheckExpr(const ast::Expr& expr, const ExprContext& context);
  std::optional<Checked> CheckName(const ast::Expr& expr, const ExprContext& context);
  std::optional<Checked> CheckUnary(const ast::Expr& expr, const ExprContext& context);
  std::optional<Checked> CheckRun(const ast::Expr& expr, const ExprContext& context);
  std::optional<Checked> BuildRun(const ast::Expr& run, std::vector<Checked>& operands);
  // Operands [begin, end) of a run of one associative operator.
  std::optional<Checked> BuildBalanced(const ast::Expr& run, std::vector<Checked>& operands,
                                       size_t begin, size_t end);
  std::optional<Checked> Combine(const ast::Expr::Operator& op, Checked left, Checked right);

  std::optional<Checked> CheckCall(const ast::Expr& expr, const ExprContext& context);
  // eval("x", "<", "1") as `x < 1`.
  std::optional<Checked> CheckEval(const ast::Expr& call, const ExprContext& context);
  // `text` as a value of the type that `variable` has; none, and reported, if it is none.
  std::optional<ast::Expr> EvalOperand(const ast::Expr& text, const ast::Expr& variable,
                                       ValueType type);
  // payload("path"), plugin("id").
  bool CheckInspection(const TypedExpr& arg, Inspection::Kind kind, uint32_t& index);
  std::optional<uint32_t> AddInspection(Inspection inspection, SourceRange range);
  bool CheckWord(const TypedExpr& arg, const Parameter& parameter,
                 const std::vector<Checked>& before, absl::string_view owner);
  bool CheckWindow(const TypedExpr& arg);
  static Reach ReachOf(const Signature& signature);
  static Reach Join(BinaryOp op, const Checked& left, const Checked& right);
  // The arguments of a call; none if any is wrong.
  std::optional<std::vector<Checked>> CheckArgs(const ast::Expr& call, const Signature& signature,
                                                const ExprContext& context);
  // list[begin] and what follows, appended to `out`. False if any is wrong.
  bool CheckList(const std::vector<ast::Expr>& list, size_t begin, absl::string_view owner,
                 const ExprContext& context, std::vector<Checked>& out);
  bool CheckArgument(const TypedExpr& arg, const Parameter& parameter,
                     const std::vector<Checked>& before, absl::string_view owner);
  bool CheckRegex(const TypedExpr& arg);
  // `of` is what a name at `range` speaks about.
  void CheckClass(absl::string_view name, SourceRange range, EventClass of,
                  const ExprContext& context);
  // name_checker.cc: names that no robot can have, and comparisons with them.
  void WarnName(const TypedExpr& arg, ParameterRole role);
  void WarnComparison(const TypedExpr& left, const TypedExpr& right);
  // Replaces a call by its value, if that is known.
  void FoldCall(const Signature& signature, Checked& call) const;

  void ReportNotAValue(const ast::Expr& name);
  void ReportNotCallable(const ast::Expr& call);
  void ReportTypes(const ast::Expr::Operator& op, const TypedExpr& left, const TypedExpr& right);
  void WarnMixedBitOperators(const ast::Expr& run);
  // `part` is an operand of something that is not decided itself.
  void WarnDecided(const ast::Expr& part, const Checked& checked, const ExprContext& context);
  void NoteDialect(const ast::Expr& call, const Signature& signature);

  const Scope& scope_;
  const std::vector<levels::Level>& levels_;
  CheckedRules::Dialect dialect_;
  const std::vector<std::string>& paths_;
  InspectionFiles* files_;
  std::vector<Inspection> inspections_;
  Usage& usage_;
  DiagnosticSink& sink_;
  bool dialect_noted_ = false;
  // Of the patterns so far.
  size_t regex_instructions_ = 0;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECK_EXPR_CHECKER_H_
