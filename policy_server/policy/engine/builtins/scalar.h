// A value while an expression is being evaluated: lang::Value without owning its text.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_SCALAR_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_SCALAR_H_

#include <cstdint>
#include <variant>

#include "absl/strings/string_view.h"

namespace rips::engine {

// Alternatives in the order of lang::Value. Text lives in the rules, in a variable or in the
// Expression that made it.
using Scalar = std::variant<int64_t, double, bool, absl::string_view>;

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_SCALAR_H_
