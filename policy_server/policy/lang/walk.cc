#include "policy_server/policy/lang/walk.h"

#include <vector>

namespace rips::lang {

void ForEachExpr(const TypedExpr& root, ExprVisitor visit) {
  std::vector<const TypedExpr*> left = {&root};
  while (!left.empty()) {
    const TypedExpr& expr = *left.back();
    left.pop_back();
    visit(expr);
    for (const TypedExpr& arg : expr.args) left.push_back(&arg);
  }
}

void ForEachExpr(const TypedRule& rule, ExprVisitor visit) {
  ForEachExpr(rule.condition, visit);
  for (const TypedChain& chain : rule.chains) {
    for (const TypedAction& action : chain) {
      for (const TypedExpr& arg : action.args) ForEachExpr(arg, visit);
    }
  }
}

}  // namespace rips::lang
