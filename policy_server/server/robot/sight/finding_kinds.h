// Kinds of findings, as rules name them. Header only.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_KINDS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_KINDS_H_

#include <algorithm>
#include <span>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/check/signature.h"

namespace rips::pipeline {

// Those that rules can ask for.
inline std::span<const absl::string_view> KindsOfRules() {
  return lang::SignatureOf(lang::Builtin::kFinding).parameters[0].words;
}

inline bool IsKindOfRules(absl::string_view kind) {
  const auto kinds = KindsOfRules();
  return std::find(kinds.begin(), kinds.end(), kind) != kinds.end();
}

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_FINDING_KINDS_H_
