// Operators on constants. What the compiler computes and what the engine computes at run time must
// be the same, so the engine may call these too.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECK_FOLD_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECK_FOLD_H_

#include <optional>

#include "policy_server/policy/lang/checked_rules.h"

namespace rips::lang {

// The operand has a type that ResultType accepts. Integers wrap around (-MinInt is MinInt).
Value Fold(UnaryOp op, const Value& operand);

// The operands have types that ResultType accepts. Integers wrap around; `/` and `%` truncate
// toward zero (MinInt / -1 is MinInt, MinInt % -1 is 0). None for an integer division by zero;
// a float's is IEEE infinity or NaN. Strings compare by bytes, false < true.
std::optional<Value> Fold(BinaryOp op, const Value& left, const Value& right);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECK_FOLD_H_
