// Evaluates the condition of a rule that fired once more and writes down what each part of it was,
// and who made it true.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_TRACE_TRACER_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_TRACE_TRACER_H_

#include <cstdint>

#include "policy_server/policy/engine/eval/frame.h"
#include "policy_server/policy/engine/state/trace.h"
#include "policy_server/policy/levels/level_table.h"

namespace rips::engine {

// Of the frame's program, at `level`, before any action of the rule has run. Changes nothing, and
// counts no step. The names that it holds are as hostile as the robot's graph.
Trace TraceRule(Frame& frame, uint32_t rule, levels::LevelIndex level);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_TRACE_TRACER_H_
