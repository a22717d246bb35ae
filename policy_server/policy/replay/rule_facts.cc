#include "policy_server/policy/replay/rule_facts.h"

#include "policy_server/policy/lang/walk.h"

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

}  // namespace

bool NeverFires(const lang::TypedRule& rule) {
  return rule.condition.is_constant() && rule.condition.constant == lang::Value(false);
}

bool AsksWhoSent(const lang::CheckedRules& rules) {
  bool asks = false;
  for (const lang::TypedRule& rule : rules.rules) {
    lang::ForEachExpr(rule, [&](const TypedExpr& expr) { asks |= IsAboutTheSender(expr); });
  }
  return asks;
}

}  // namespace rips::replay
