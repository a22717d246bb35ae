#include "policy_server/policy/replay/rule_facts.h"

#include <algorithm>
#include <vector>

namespace rips::replay {
namespace {

using lang::Builtin;
using lang::Predefined;
using lang::TypedExpr;

// `expr` itself, without its arguments.
bool IsAboutTheSender(const TypedExpr& expr) {
  if (expr.kind == TypedExpr::Kind::kCall) {
    return expr.builtin == Builtin::kSenderIn || expr.builtin == Builtin::kSenderCount ||
           expr.builtin == Builtin::kSenderEnclave;
  }
  if (expr.kind != TypedExpr::Kind::kPredefined) return false;
  switch (expr.predefined) {
    case Predefined::kSender:
    case Predefined::kSenderGuid:
      return true;
    case Predefined::kCurrLevel:
    case Predefined::kLevel:
    case Predefined::kTime:
    case Predefined::kUptime:
    case Predefined::kCurrRule:
    case Predefined::kRobot:
    case Predefined::kTopic:
    case Predefined::kMsgType:
    case Predefined::kIdsSource:
    case Predefined::kIdsTarget:
      break;
  }
  return false;
}

// Expressions may be thousands of operators deep.
bool AsksWhoSent(const TypedExpr& root) {
  std::vector<const TypedExpr*> left = {&root};
  while (!left.empty()) {
    const TypedExpr& expr = *left.back();
    left.pop_back();
    if (IsAboutTheSender(expr)) return true;
    for (const TypedExpr& arg : expr.args) left.push_back(&arg);
  }
  return false;
}

bool AsksWhoSent(const lang::TypedRule& rule) {
  if (AsksWhoSent(rule.condition)) return true;
  for (const lang::TypedChain& chain : rule.chains) {
    for (const lang::TypedAction& action : chain) {
      for (const TypedExpr& arg : action.args) {
        if (AsksWhoSent(arg)) return true;
      }
    }
  }
  return false;
}

}  // namespace

bool NeverFires(const lang::TypedRule& rule) {
  const TypedExpr& condition = rule.condition;
  return condition.kind == TypedExpr::Kind::kConstant && condition.constant == lang::Value(false);
}

bool AsksWhoSent(const lang::CheckedRules& rules) {
  return std::any_of(rules.rules.begin(), rules.rules.end(),
                     [](const lang::TypedRule& rule) { return AsksWhoSent(rule); });
}

}  // namespace rips::replay
