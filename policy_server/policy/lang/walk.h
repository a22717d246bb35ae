// Walks through the expressions of checked rules.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_WALK_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_WALK_H_

#include "absl/functional/function_ref.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::lang {

using ExprVisitor = absl::FunctionRef<void(const TypedExpr&)>;

// Visits `root` and every expression inside it, in no particular order and without recursion:
// expressions may be thousands of operators deep.
void ForEachExpr(const TypedExpr& root, ExprVisitor visit);
// The same for the rule's condition and all arguments of its actions.
void ForEachExpr(const TypedRule& rule, ExprVisitor visit);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_WALK_H_
