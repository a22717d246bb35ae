#include "mode_actuator/decide/drift_watch.h"

#include <algorithm>

#include "absl/strings/str_cat.h"

namespace rips::actuator {

void DriftWatch::Reset() { *this = DriftWatch(); }

int DriftWatch::Recent(int64_t now_ns) const {
  return static_cast<int>(std::count_if(left_ns_.begin(), left_ns_.end(), [&](int64_t at_ns) {
    return now_ns - at_ns < kDriftWindowNs;
  }));
}

void DriftWatch::Left(int64_t now_ns) {
  while (!left_ns_.empty() && now_ns - left_ns_.front() >= kDriftWindowNs) left_ns_.pop_front();
  left_ns_.push_back(now_ns);
  const bool popped = popped_ns_.has_value() && now_ns - *popped_ns_ < kDriftWindowNs;
  if (Recent(now_ns) >= kDriftsMax && !popped) due_ = true;
}

bool DriftWatch::PopDue(int64_t now_ns) {
  if (!due_) return false;
  due_ = false;
  popped_ns_ = now_ns;
  what_followed_.clear();
  return true;
}

void DriftWatch::Ran(absl::string_view failure) {
  what_followed_ = failure.empty() ? "; its on_drift steps were run"
                                   : absl::StrCat("; its on_drift steps failed: ", failure);
}

std::string DriftWatch::Degraded(absl::string_view level, int64_t now_ns) const {
  const int recent = Recent(now_ns);
  const bool followed = popped_ns_.has_value() && now_ns - *popped_ns_ < kDriftWindowNs;
  if (recent < kDriftsMax && !followed) return "";
  return absl::StrCat(level, " was left again and again: ", recent, " times in ",
                      kDriftWindowNs / kNanosPerSecond, " s", what_followed_);
}

}  // namespace rips::actuator
