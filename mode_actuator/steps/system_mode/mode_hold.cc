#include "mode_actuator/steps/system_mode/mode_hold.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::actuator {

void ModeHold::Reached(absl::string_view mode, std::string without,
                       std::optional<ros2::Guid> told) {
  mode_ = std::string(mode);
  without_ = std::move(without);
  told_ = told;
}

void ModeHold::Left(absl::string_view mode, absl::string_view other, int64_t now_ns) {
  leaves_.push_back({now_ns, std::string(mode), std::string(other)});
  if (leaves_.size() > kLeavesKept) leaves_.pop_front();
}

int ModeHold::LeavesOf(absl::string_view mode, int64_t now_ns) const {
  return static_cast<int>(std::count_if(leaves_.begin(), leaves_.end(), [&](const Leave& leave) {
    return leave.mode == mode && now_ns - leave.at_ns < kLeaveWindowNs;
  }));
}

std::string ModeHold::WhyNotManager(absl::string_view mode, int64_t now_ns) const {
  const int leaves = LeavesOf(mode, now_ns);
  if (leaves < kLeavesMax) return "";
  const auto last = std::find_if(leaves_.rbegin(), leaves_.rend(),
                                 [&](const Leave& leave) { return leave.mode == mode; });
  return absl::StrCat("the mode manager left ", mode, " for ", last->other, " ", leaves,
                      " times in ", kLeaveWindowNs / kNanosPerSecond,
                      " s; does its SMH file have rules, or does another node order it?");
}

std::string ModeHold::Degraded(int64_t now_ns) const {
  const std::string leaves = WhyNotManager(mode_, now_ns);
  if (direct()) {
    return absl::StrCat(part_, "=", mode_,
                        " is held without the mode manager: ", leaves.empty() ? without_ : leaves);
  }
  return leaves.empty() ? "" : absl::StrCat(part_, ": ", leaves);
}

}  // namespace rips::actuator
