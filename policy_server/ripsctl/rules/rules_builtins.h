// `ripsctl rules builtins`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_BUILTINS_H_
#define RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_BUILTINS_H_

#include <memory>

#include "policy_server/ripsctl/cli/command.h"

namespace rips::ripsctl {

// The reference of the rule language, from the tables that its checker reads: as text, as Markdown
// (`--markdown`) or as JSON:
// [{"name","kind":"builtin|action|predefined","class":"universal|Msg|Graph|External","usage",
//   "result","help","extension":bool,"words":[{"parameter","after"?,"values":[..]}]}]
// `extension`: an addition, so a program may declare the name as its own. `words`: what a parameter
// may be; `after`: if the argument before it is this.
std::unique_ptr<Command> RulesBuiltins();

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_RULES_RULES_BUILTINS_H_
