// Checked rules to what the evaluator runs.
#ifndef RIPS_POLICY_SERVER_ENGINE_COMPILER_H_
#define RIPS_POLICY_SERVER_ENGINE_COMPILER_H_

#include <memory>

#include "absl/status/statusor.h"
#include "policy_server/engine/compiled.h"

namespace rips::engine {

// `rules` must outlive the result, which views them. InvalidArgument for rules that the checker
// would not have let through: an operand of the wrong type, a name that is not there, a pattern
// that does not compile.
absl::StatusOr<std::unique_ptr<const Program::Compiled>> CompileRules(
    const lang::CheckedRules& rules);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_ENGINE_COMPILER_H_
