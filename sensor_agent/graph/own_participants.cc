#include "sensor_agent/graph/own_participants.h"

#include <algorithm>
#include <utility>

namespace rips::sensor {

using ros2::Guid;

bool OwnParticipants::Told(const std::vector<Guid>& participants) {
  const absl::btree_set<Guid> before =
      std::exchange(told_, absl::btree_set<Guid>(participants.begin(), participants.end()));
  former_.erase(std::remove_if(former_.begin(), former_.end(),
                               [&](const Guid& guid) { return told_.contains(guid); }),
                former_.end());
  for (const Guid& guid : before) {
    if (!told_.contains(guid)) former_.push_back(guid);
  }
  while (former_.size() > kFormerMax) former_.pop_front();
  std::vector<Guid> known(told_.begin(), told_.end());
  known.insert(known.end(), former_.begin(), former_.end());
  std::sort(known.begin(), known.end());
  if (known == known_) return false;
  known_ = std::move(known);
  return true;
}

}  // namespace rips::sensor
