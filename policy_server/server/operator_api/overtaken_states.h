// States of robots that a watch was not told because it reads slowly.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_OVERTAKEN_STATES_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_OVERTAKEN_STATES_H_

#include <cstddef>
#include <set>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "services/runtime/mutex.h"

namespace rips::operator_api {

// Only the newest state of a robot counts. So while kWaitingMax states wait to be read, the names
// of robots are kept instead of further states, and each is sent as it is then, when the watch has
// read all. Any thread.
class OvertakenStates {
 public:
  static constexpr size_t kWaitingMax = 256;

  // True if `robot` is to be told later, since so many states wait already. `waiting()` says how
  // many do; it is asked under the lock, so that a Take() after the last one was read finds the
  // robot.
  template <typename Waiting>
  bool Skip(const std::string& robot, const Waiting& waiting) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (waiting() < kWaitingMax) return false;
    robots_.insert(robot);
    return true;
  }
  // Those that are to be told now.
  std::set<std::string> Take() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    return std::exchange(robots_, {});
  }

 private:
  Mutex mu_;
  std::set<std::string> robots_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_OVERTAKEN_STATES_H_
