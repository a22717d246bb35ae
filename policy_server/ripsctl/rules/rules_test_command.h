// `ripsctl rules test`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_TEST_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_TEST_COMMAND_H_

#include <memory>

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// Runs unit tests of rules (policy_server/policy/replay/rule_test_file.h). Exits with kDone if all
// passed, kRefused if one failed or rules do not compile, kUsage if a file cannot be read or is not
// well formed; then no test is run. JSON:
// {"tests":count,"failed":count,"files":[{"path","ok":bool,"tests":[{"name","line","ok":bool,
//  "failures":[{"line","what","expected":[..],"got":[..]}]}],"not_exercised":[rules],
//  "refused"?:{as rules check}}]}. `--output junit`: one test suite a file.
std::unique_ptr<Command> TestRules();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_TEST_COMMAND_H_
