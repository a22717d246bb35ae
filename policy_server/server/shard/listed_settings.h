// What is in force for the policy server and for each robot of its inventory, and which line of
// which file says it, for calls of operators.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_LISTED_SETTINGS_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_LISTED_SETTINGS_H_

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "services/base/config_setting.h"
#include "services/runtime/mutex.h"

namespace rips::pipeline {

// Any thread.
class ListedSettings {
 public:
  using OfRobots = absl::btree_map<std::string, std::vector<ConfigSetting>>;  // by id

  // `own`: the policy server's.
  explicit ListedSettings(std::vector<ConfigSetting> own) : own_(std::move(own)) {}

  void Set(OfRobots robots) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    robots_ = std::move(robots);
  }
  const std::vector<ConfigSetting>& own() const { return own_; }
  // nullopt: no such robot is listed.
  std::optional<std::vector<ConfigSetting>> Of(const std::string& robot) const
      ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    const auto found = robots_.find(robot);
    if (found == robots_.end()) return std::nullopt;
    return found->second;
  }

 private:
  const std::vector<ConfigSetting> own_;
  mutable Mutex mu_;
  OfRobots robots_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_LISTED_SETTINGS_H_
