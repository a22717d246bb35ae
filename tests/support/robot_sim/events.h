// What the simulator tells programs: one JSON object per line on stdout.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_EVENTS_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_EVENTS_H_

#include "nlohmann/json_fwd.hpp"

namespace rips::robot_sim {

// Prints `event` at once. Text that is no UTF-8 is printed with U+FFFD in its place.
void PrintEvent(const nlohmann::ordered_json& event);

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_EVENTS_H_
