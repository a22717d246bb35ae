// How the engine writes and cuts text.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TEXT_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TEXT_H_

#include <cstddef>
#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::engine {

// The longest start of `text` of at most `max` code points. A byte that is not part of well-formed
// UTF-8 counts as one. A view of `text`.
absl::string_view CutCodePoints(absl::string_view text, size_t max);

// The shortest decimal that reads back as `value`: `1`, `0.1`, `1e+21`, `1e-05`; with an exponent
// below 1e-4 and from 1e21. NaN, +Inf, -Inf.
std::string FormatFloat(double value);

// As `string(x)` writes it.
std::string ToText(const lang::Value& value);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_TEXT_H_
