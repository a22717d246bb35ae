// Evaluates the condition of a rule that fired once more and writes down what each part of it was,
// and who made it true.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_TRACE_TRACER_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_TRACE_TRACER_H_

#include <cstddef>
#include <cstdint>

#include "policy_server/policy/engine/eval/frame.h"
#include "policy_server/policy/engine/state/trace.h"
#include "policy_server/policy/levels/level_table.h"
#include "services/model/observation.h"
#include "services/ros2/ros_graph.h"

namespace rips::engine {

// Of the frame's program, at `level`, before any action of the rule has run. Changes nothing, and
// counts no step. The names that it holds are as hostile as the robot's graph.
Trace TraceRule(Frame& frame, uint32_t rule, levels::LevelIndex level);

// Where the rule stands, and its condition; nothing of what it is now.
Trace DescribeRule(const CompiledPolicy& program, uint32_t rule);

// Of RIPS's own alert of a finding: the finding, and the participants that it is about as the graph
// shows them; at most `subjects_max`, and kSubjectsMax.
Trace TraceFinding(const model::Finding& finding, const ros2::RosGraph& graph,
                   size_t subjects_max = kSubjectsMax);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_TRACE_TRACER_H_
