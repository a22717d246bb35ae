// Warns of triggers that lower a level without asking why it was raised, and of triggers that would
// lower it and never can.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_CHECK_LOWERING_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_CHECK_LOWERING_H_

#include <cstdint>
#include <vector>

#include "policy_server/policy/lang/checked_rules.h"
#include "policy_server/policy/lang/diagnostic/diagnostic_sink.h"

namespace rips::lang {

// Adds a warning for each `trigger` in `rules` that is one of these, and none for others:
//
//   kind                the trigger
//   UnguardedLowering   may leave a soft level for the one below, and its rule fires at that level
//                       although nothing but the level and the time is asked, or besides only
//                       that there is no event, as at each tick; or because a finding stands
//   NeverLowers         changes nothing at any level at which its rule may fire, and asks for a
//                       lower level at one of them at least
//
// A rule may fire at a level unless its expression says otherwise by what it asks of `CurrLevel`
// and `Level`. Variables and builtins may be anything; `Time`, `Uptime`, `Robot` and `CurrRule` say
// nothing about what was wrong. What stands behind an `exec` or a `trigger` of its chain runs
// later, at any level. `rules` has no errors; `variable_levels` are the levels that each variable
// may hold.
void WarnLowerings(const CheckedRules& rules, const std::vector<uint64_t>& variable_levels,
                   DiagnosticSink& sink);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_CHECK_LOWERING_H_
