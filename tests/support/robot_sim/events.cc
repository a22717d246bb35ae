#include "tests/support/robot_sim/events.h"

#include <cstdio>
#include <string>

#include "nlohmann/json.hpp"

namespace rips::robot_sim {

void PrintEvent(const nlohmann::ordered_json& event) {
  const std::string line =
      event.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
  std::fwrite(line.data(), 1, line.size(), stdout);
  std::fflush(stdout);
}

}  // namespace rips::robot_sim
