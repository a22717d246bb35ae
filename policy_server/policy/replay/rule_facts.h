// What can be said of rules without running them.
#ifndef RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_FACTS_H_
#define RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_FACTS_H_

#include "policy_server/policy/lang/checked_rules.h"

namespace rips::replay {

// `false ? ...`, or an expression that comes to that: whoever writes it knows that it never fires.
bool NeverFires(const lang::TypedRule& rule);

// Some expression asks who sent a message: `senderin`, `sendercount`, `senderenclave`, `Sender`,
// `SenderGuid`.
bool AsksWhoSent(const lang::CheckedRules& rules);

}  // namespace rips::replay

#endif  // RIPS_POLICY_SERVER_POLICY_REPLAY_RULE_FACTS_H_
