// A ROS graph for `ripsctl robot graph`. What a process says of itself (address, host, process id)
// may be false.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_ROBOT_GRAPH_VIEW_H_
#define RIPS_POLICY_SERVER_RIPSCTL_ROBOT_GRAPH_VIEW_H_

#include <nlohmann/json_fwd.hpp>

#include "policy_server/ripsctl/cli/text_stream.h"
#include "rips/v1/observation.pb.h"

namespace rips::ripsctl {

// {"nodes":[{"name","services":[..],"processes":[PROCESS]}],
//  "topics":[{"name","types":[..],"publishers":[..],"subscribers":[..]}],
//  "unattributed":[{"guid","topic","kind","process":PROCESS or null}]}
// PROCESS is {"address","host","pid"}; pid is null when not known. Sorted; publishers and
// subscribers have one entry per endpoint, a node one process per DDS participant. Endpoints
// without a node and those that are not ROS are under `unattributed`.
nlohmann::ordered_json GraphJson(const v1::GraphSnapshot& graph);

// The same as tables. Of the topic by which ROS 2 processes say which nodes are theirs it gives
// only the count: each of them has its two endpoints, without a node.
void PrintGraph(const v1::GraphSnapshot& graph, TextStream out);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_ROBOT_GRAPH_VIEW_H_
