// Values as text: what `string(x)` returns, and what traces and tools show.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_VALUE_TEXT_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_VALUE_TEXT_H_

#include <string>

#include "policy_server/policy/lang/checked_rules.h"

namespace rips::lang {

// Integers in decimal, `true`/`false`, a string as it is; floats as FormatFloat.
std::string ToText(const Value& value);

// The fewest digits that read back as `value`; with an exponent of at least two digits below 1e-4
// and from 1e21: 1, 0.5, 1e+21, 1e-05. NaN, +Inf, -Inf.
std::string FormatFloat(double value);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_VALUE_TEXT_H_
