// Runs the rules of one robot on one event. Pure: the result is a function of the arguments.
//
// Expressions are evaluated left to right, the right side only if it can matter (evaluation.h). A
// fault anywhere that is evaluated makes the rule not fire and is alerted at most once per second
// and rule. A rule whose value depends on an inspection that was not told fires, unless the policy
// says otherwise (CompiledPolicyOptions); in an argument of an action that is a fault. Actions
// before a fault in their chain stay done; the action whose argument faults fails, its chain goes
// on as its connectors say, and the rule's later chains do not run.
//
// Chain: `a => b` runs b if a succeeded, `a !> b` if a failed, `a , b` always; the first connector
// that says no ends the chain. exec and trigger answer later: the chain is parked (unless nothing
// follows) and goes on in OnProgramResult, OnActuation or Expire.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_EVALUATOR_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_EVALUATOR_H_

#include <string>
#include <vector>

#include "policy_server/policy/engine/state/effect.h"
#include "policy_server/policy/engine/state/event.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "services/base/clock.h"

namespace rips::engine {

// What an inspection must be asked before the message is judged: all that its rules may look at,
// whatever the graph, the variables and the level are by then. Indices into
// CheckedRules::inspections of the program in force, ascending, distinct. Empty for other events.
std::vector<uint32_t> NeededInspections(const Event& event, Instant now, RobotState& state);

// Runs every rule of the event's class, in file order. Nothing while the robot's rules are halted.
Outcome Evaluate(const Event& event, Instant now, RobotState& state);

// The program of a RunProgramEffect exited 0 in time (`ok`) or not; chains waiting for it go on.
// Unknown and repeated ids do nothing.
Outcome OnProgramResult(uint64_t run_id, bool ok, Instant now, RobotState& state);

// `state.actuation` has changed, or the level has: chains waiting for a level go on with success if
// the level they asked for is verified (raise: at it or above; lowering: at it), with failure if
// the actuation failed or there is no lease.
Outcome OnActuation(Instant now, RobotState& state);

// Parked chains past their deadline go on with failure. Call at least once a second.
Outcome Expire(Instant now, RobotState& state);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_EVALUATOR_H_
