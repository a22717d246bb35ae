// Labels of the robots of the inventory in force, for calls of operators.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_ROBOT_LABELS_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_ROBOT_LABELS_H_

#include <algorithm>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "absl/container/btree_set.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {

// Any thread.
class RobotLabels {
 public:
  // `KEY=VALUE`, by robot.
  using Labels = absl::btree_map<std::string, absl::btree_set<std::string>>;

  void Set(Labels labels) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    labels_ = std::move(labels);
  }
  // The robot has each of `wanted`; true if that is empty.
  template <typename Range>
  bool HasAll(const std::string& robot, const Range& wanted) const ABSL_LOCKS_EXCLUDED(mu_) {
    if (wanted.empty()) return true;
    MutexLock lock(&mu_);
    const auto found = labels_.find(robot);
    return found != labels_.end() &&
           std::all_of(wanted.begin(), wanted.end(),
                       [&](const std::string& label) { return found->second.contains(label); });
  }

 private:
  mutable Mutex mu_;
  Labels labels_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_ROBOT_LABELS_H_
