// Orders to the nodes of a part themselves, without a mode manager: their lifecycle and parameter
// services only, which every ROS 2 lifecycle node has.
//
// Nodes that are as expected are left alone. The others, in this order, which is safest first:
//   1. what must be inactive is deactivated (or configured, from unconfigured)
//   2. what is active and stays so gets its parameters
//   3. what must become active is configured if need be, gets its parameters, and is activated
// A node that is silent or refuses does not keep the others waiting for more than one call
// (kNodeOrderTimeout); it is asked last from then on.
// A node whose get_state several servers offer is not read, and nothing of it counts as reached. So
// that the robot's own node has its order all the same, each of them gets it, every kBlindPeriod:
// to deactivate, or to take the parameters. None is activated unread.
#ifndef RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_DIRECT_MODES_H_
#define RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_DIRECT_MODES_H_

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/system_mode/node_client.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/base/clock.h"
#include "services/runtime/cancel_flag.h"

namespace rips::actuator {

inline constexpr absl::Duration kReadPeriod = absl::Milliseconds(100);  // between two looks
inline constexpr absl::Duration kBlindPeriod = absl::Milliseconds(500);
inline constexpr size_t kDetailPartsMax = 8;  // parts named in one message

using NodeClients = absl::btree_map<std::string, std::unique_ptr<NodeClient>>;

// `a, b and 3 more`.
std::string JoinParts(const std::vector<std::string>& parts);

// Brings the nodes to what is expected and reads them back, until `end_ns`. Each of `expected` must
// be in `nodes`. Cancelled; DeadlineExceeded, naming what is wrong at the end and, of each node
// that refused, why. Returns within one call after `end_ns`. One thread at a time per node.
absl::Status OrderNodes(NodeClients& nodes, const std::vector<ExpectedPart>& expected,
                        int64_t end_ns, const Clock& clock, const CancelFlag& cancel);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_SYSTEM_MODE_DIRECT_MODES_H_
