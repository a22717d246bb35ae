// When to alert about a truncated graph. Pure; header only.
//
// | the graph                                   | alert                                           |
// |---------------------------------------------|-------------------------------------------------|
// | is truncated for kGatherNs, or is whole     | one, critical, with the counts by then          |
// | again before that                           |                                                 |
// | stays truncated                             | none                                            |
// | stays truncated, and a participant lacks    | one for that participant; kCrowdsMax in all     |
// | something of which none was named yet       |                                                 |
// | is whole again                              | one, that it is over                            |
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_TRUNCATION_ALARM_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_TRUNCATION_ALARM_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "absl/container/flat_hash_set.h"
#include "services/base/clock.h"
#include "services/ros2/graph_limits.h"

namespace rips::pipeline {

// Not thread-safe.
class TruncationAlarm {
 public:
  // A flood is under way when the first of it is left out.
  static constexpr int64_t kGatherNs = 500 * kNanosPerMilli;
  static constexpr size_t kCrowdsMax = 32;

  struct Due {
    bool began = false;
    // As of the newest truncated graph.
    uint64_t left_out = 0;
    // Named for the first time since it began.
    std::vector<ros2::Truncation::Crowd> crowds;
    bool over = false;
  };

  // The newest graph lacks this; times never go back. True if it was whole before.
  bool Set(const ros2::Truncation& truncation, int64_t now_ns) {
    if (truncation.left_out == 0) {
      if (since_ns_.has_value()) ended_ = true;
      return false;
    }
    ended_ = false;
    latest_ = truncation;
    if (since_ns_.has_value()) return false;
    since_ns_ = now_ns;
    return true;
  }

  Due Pop(int64_t now_ns) {
    Due due;
    if (!since_ns_.has_value() || (!ended_ && now_ns - *since_ns_ < kGatherNs)) return due;
    due.began = !told_;
    due.left_out = latest_.left_out;
    told_ = true;
    for (const ros2::Truncation::Crowd& crowd : latest_.crowds) {
      if (named_.size() >= kCrowdsMax) break;
      if (named_.insert(crowd.participant).second) due.crowds.push_back(crowd);
    }
    due.over = ended_;
    if (ended_) *this = {};
    return due;
  }

 private:
  std::optional<int64_t> since_ns_;
  ros2::Truncation latest_;
  bool told_ = false;
  bool ended_ = false;
  absl::flat_hash_set<ros2::Guid> named_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_TRUNCATION_ALARM_H_
