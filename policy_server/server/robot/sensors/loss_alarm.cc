#include "policy_server/server/robot/sensors/loss_alarm.h"

#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/base/saturating.h"

namespace rips::pipeline {
void LossAlarm::Add(absl::string_view cause, uint64_t count, int64_t now_ns) {
  if (count == 0) return;
  last_loss_ns_ = now_ns;
  total_ = SaturatingAdd(total_, count);
  std::string key(cause.empty() ? "no cause was told" : cause);
  if (!fresh_.contains(key) && fresh_.size() >= kCausesMax) key = "other causes";
  uint64_t& sum = fresh_[key];
  sum = SaturatingAdd(sum, count);
}

std::string LossAlarm::Causes() const {
  std::vector<std::string> parts;
  for (const auto& [cause, count] : fresh_) parts.push_back(absl::StrCat(count, " (", cause, ")"));
  return absl::StrJoin(parts, "; ");
}

std::optional<LossAlarm::News> LossAlarm::Due(int64_t now_ns) {
  if (!losing_) {
    if (fresh_.empty()) return std::nullopt;
    losing_ = true;
    told_ns_ = now_ns;
    News news{engine::Severity::kHigh, absl::StrCat("observations were lost: ", Causes())};
    fresh_.clear();
    return news;
  }
  if (now_ns - last_loss_ns_ >= kEveryNs) {
    News news{engine::Severity::kInfo,
              absl::StrCat("no observation was lost for a minute; ", total_, " were lost in all")};
    if (!fresh_.empty()) absl::StrAppend(&news.text, "; since last told ", Causes());
    *this = LossAlarm();
    return news;
  }
  if (now_ns - told_ns_ < kEveryNs || fresh_.empty()) return std::nullopt;
  told_ns_ = now_ns;
  News news{engine::Severity::kHigh, absl::StrCat("observations are still being lost, ", total_,
                                                  " so far; since last told ", Causes())};
  fresh_.clear();
  return news;
}

}  // namespace rips::pipeline
