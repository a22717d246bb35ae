// Who reads, sets and triggers what, and what follows from it for the whole program.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECK_USAGE_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECK_USAGE_H_

#include <cstdint>
#include <optional>
#include <vector>

#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/policy/lang/diagnostic/diagnostic_sink.h"

namespace rips::lang {

class Usage {
 public:
  // In the order of their indices. `initial` has been checked.
  void DeclareLevel(SourceRange name) { levels_.push_back(name); }
  void DeclareVariable(SourceRange name, const TypedExpr& initial);

  void Read(uint32_t variable) { variables_[variable].read = true; }
  // set(variable, value).
  void Set(uint32_t variable, const TypedExpr& value);
  // trigger(level) with a level name or a constant that is one.
  void Trigger(int level) { reached_ |= Bit(level); }
  // trigger(variable), an int one.
  void TriggerVariable(uint32_t variable, SourceRange range);

  // By index of the variable: the levels that may flow into it, one bit each.
  std::vector<uint64_t> LevelsOfVariables() const;

  // Reports triggers of variables that may hold something else than a level: every value that
  // flows into such a variable, from its initialiser, from a `set` or from another variable, must
  // be a level name or `CurrLevel`.
  void ReportBadTriggers(const std::vector<Variable>& variables, DiagnosticSink& sink) const;

  // Reports levels that no trigger reaches (the first always is), variables never read and
  // variables never set. Meaningful only for a program without errors.
  void ReportUnused(const std::vector<Variable>& variables, const levels::LevelTable& levels,
                    DiagnosticSink& sink) const;

 private:
  struct VariableUse {
    SourceRange name;
    bool read = false;
    bool set = false;
    // Bit i: level i flows into it.
    uint64_t levels = 0;
    // `CurrLevel` flows into it.
    bool any_level = false;
    // Where something that is no level flows into it.
    std::optional<SourceRange> other;
    // Variables that are copied into it.
    std::vector<uint32_t> sources;
  };
  struct VariableTrigger {
    uint32_t variable;
    SourceRange range;
  };

  static uint64_t Bit(int level) { return uint64_t{1} << level; }
  void Flow(uint32_t variable, const TypedExpr& value);
  // `variables_` with what reaches them through copies of other variables.
  std::vector<VariableUse> Closure() const;

  std::vector<SourceRange> levels_;
  std::vector<VariableUse> variables_;
  std::vector<VariableTrigger> triggers_;
  uint64_t reached_ = 0;
};

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECK_USAGE_H_
