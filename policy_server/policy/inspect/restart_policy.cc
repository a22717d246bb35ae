#include "policy_server/policy/inspect/restart_policy.h"

#include <algorithm>

namespace rips::inspect {

bool RestartPolicy::MayAsk(absl::string_view robot, int64_t now_ns) const {
  if (now_ns < start_.until_ns) return false;
  const auto blamed = robots_.find(robot);
  return blamed == robots_.end() || now_ns >= blamed->second.until_ns;
}

void RestartPolicy::Lengthen(Wait& wait, int64_t now_ns) const {
  const int64_t first_ns = absl::ToInt64Nanoseconds(limits_.first);
  const int64_t longest_ns = absl::ToInt64Nanoseconds(limits_.longest);
  const bool anew = wait.delay_ns == 0 || now_ns - wait.until_ns > longest_ns;
  wait.delay_ns = std::min(anew ? first_ns : 2 * wait.delay_ns, longest_ns);
  wait.until_ns = now_ns + wait.delay_ns;
}

void RestartPolicy::StartFailed(int64_t now_ns) { Lengthen(start_, now_ns); }

void RestartPolicy::AnswerFailed(absl::string_view robot, int64_t now_ns) {
  if (robots_.size() >= limits_.robots_max && !robots_.contains(robot)) {
    absl::erase_if(robots_, [now_ns](const auto& each) { return now_ns >= each.second.until_ns; });
    if (robots_.size() >= limits_.robots_max) {
      StartFailed(now_ns);
      return;
    }
  }
  Lengthen(robots_[robot], now_ns);
}

}  // namespace rips::inspect
