#include "services/ros2/graph_limits.h"

#include <algorithm>
#include <tuple>

namespace rips::ros2 {

void KeepLargest(std::vector<Truncation::Crowd>& crowds) {
  std::sort(crowds.begin(), crowds.end(),
            [](const Truncation::Crowd& a, const Truncation::Crowd& b) {
              return std::tie(b.left_out, a.participant) < std::tie(a.left_out, b.participant);
            });
  if (crowds.size() > Truncation::kCrowdsMax) crowds.resize(Truncation::kCrowdsMax);
}

}  // namespace rips::ros2
