#include "policy_server/engine/program.h"

#include <utility>

#include "policy_server/engine/compiler.h"
#include "services/base/status_macros.h"

namespace rips::engine {

Program::Program(lang::CheckedRules rules, ProgramOptions options)
    : rules_(std::move(rules)), options_(options) {}
Program::~Program() = default;

absl::StatusOr<std::shared_ptr<const Program>> Program::Create(lang::CheckedRules rules,
                                                               ProgramOptions options) {
  std::shared_ptr<Program> program(new Program(std::move(rules), options));
  // What is compiled views the rules where they now stand.
  RIPS_ASSIGN_OR_RETURN(program->compiled_, CompileRules(program->rules_));
  return program;
}

}  // namespace rips::engine
