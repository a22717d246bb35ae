#include "policy_server/policy/lang/check/usage.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/limits.h"
#include "services/text/quote.h"

namespace rips::lang {

static_assert(kLevelsMax <= 64, "Usage keeps sets of levels in 64 bits");

void Usage::DeclareVariable(SourceRange name, const TypedExpr& initial) {
  variables_.push_back({.name = name});
  Flow(static_cast<uint32_t>(variables_.size() - 1), initial);
}

void Usage::Set(uint32_t variable, const TypedExpr& value) {
  variables_[variable].set = true;
  Flow(variable, value);
}

void Usage::Flow(uint32_t variable, const TypedExpr& value) {
  VariableUse& use = variables_[variable];
  if (value.kind == TypedExpr::Kind::kVariable) {
    if (std::find(use.sources.begin(), use.sources.end(), value.variable) == use.sources.end()) {
      use.sources.push_back(value.variable);
    }
  } else if (value.type != ValueType::kLevel) {
    if (!use.other) use.other = value.range;
  } else if (value.is_constant()) {
    use.levels |= Bit(static_cast<int>(std::get<int64_t>(value.constant)));
  } else {
    use.any_level = true;
  }
}

void Usage::TriggerVariable(uint32_t variable, SourceRange range) {
  triggers_.push_back({.variable = variable, .range = range});
}

std::vector<Usage::VariableUse> Usage::Closure() const {
  std::vector<VariableUse> out = variables_;
  // Each round carries a value one copy further, and every round but the last adds something, so
  // this ends; chains of copies are short in practice.
  for (bool changed = true; changed;) {
    changed = false;
    for (VariableUse& use : out) {
      for (const uint32_t source : use.sources) {
        const VariableUse& from = out[source];
        if ((from.levels & ~use.levels) != 0 || (from.any_level && !use.any_level) ||
            (from.other && !use.other)) {
          use.levels |= from.levels;
          use.any_level |= from.any_level;
          if (!use.other) use.other = from.other;
          changed = true;
        }
      }
    }
  }
  return out;
}

std::vector<uint64_t> Usage::LevelsOfVariables() const {
  std::vector<uint64_t> out;
  for (const VariableUse& use : Closure()) out.push_back(use.any_level ? ~uint64_t{0} : use.levels);
  return out;
}

void Usage::ReportBadTriggers(const std::vector<Variable>& variables, DiagnosticSink& sink) const {
  if (triggers_.empty()) return;
  const std::vector<VariableUse> uses = Closure();
  for (const VariableTrigger& trigger : triggers_) {
    if (!uses[trigger.variable].other) continue;
    sink.Add(DiagnosticKind::kBadTriggerLevel, trigger.range,
             absl::StrCat(Quote(variables[trigger.variable].name),
                          " may hold an integer that is not a level"),
             "its initialiser and every `set` must be a level name or `CurrLevel`");
  }
}

void Usage::ReportUnused(const std::vector<Variable>& variables, const levels::LevelTable& levels,
                         DiagnosticSink& sink) const {
  uint64_t reached = reached_;
  if (!triggers_.empty()) {
    const std::vector<VariableUse> uses = Closure();
    for (const VariableTrigger& trigger : triggers_) reached |= uses[trigger.variable].levels;
  }
  for (int i = 1; i < levels.size(); ++i) {
    if ((reached & Bit(i)) != 0) continue;
    const std::string& name = levels.at(i).name;
    sink.Add(DiagnosticKind::kLevelUnreachable, levels_[i],
             absl::StrCat("no `trigger` reaches level ", Quote(name)),
             absl::StrCat("if that is meant, say so with `false ? trigger(", name, ");`"));
  }
  for (size_t i = 0; i < variables.size(); ++i) {
    const VariableUse& use = variables_[i];
    const std::string& name = variables[i].name;
    const std::string hatch =
        absl::StrCat("if that is meant, say so with `false ? set(", name, ", ", name, ");`");
    if (!use.read) {
      sink.Add(DiagnosticKind::kVariableNeverRead, use.name,
               absl::StrCat("variable ", Quote(name), " is never read"), hatch);
    }
    if (!use.set) {
      sink.Add(DiagnosticKind::kVariableNeverSet, use.name,
               absl::StrCat("variable ", Quote(name), " is never set"),
               absl::StrCat("make it a constant; ", hatch));
    }
  }
}

}  // namespace rips::lang
