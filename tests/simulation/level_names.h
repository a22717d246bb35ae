// The levels of the simulated robot, least restrictive first.
#ifndef RIPS_TESTS_SIMULATION_LEVEL_NAMES_H_
#define RIPS_TESTS_SIMULATION_LEVEL_NAMES_H_

#include <algorithm>
#include <iterator>

#include "absl/strings/string_view.h"

namespace rips::simulation {

inline constexpr absl::string_view kLevels[] = {"DEFAULT", "ALERT", "COMPROMISED", "HALT"};

// -1 = no level.
inline int LevelIndex(absl::string_view name) {
  const auto* const found = std::find(std::begin(kLevels), std::end(kLevels), name);
  return found == std::end(kLevels) ? -1 : static_cast<int>(found - std::begin(kLevels));
}

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_LEVEL_NAMES_H_
