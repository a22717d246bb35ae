#include "policy_server/server/robot/context/alert_limiter.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::pipeline {

bool AlertLimiter::Admit(const std::string& kind, const engine::AlertEffect& alert, Instant now) {
  auto [it, fresh] = buckets_.try_emplace(kind);
  Bucket& bucket = it->second;
  if (fresh) {
    bucket.tokens = limits_.burst;
    bucket.refilled_ns = now.boottime_ns;
  }
  const double passed_s =
      static_cast<double>(now.boottime_ns - bucket.refilled_ns) / kNanosPerSecond;
  bucket.tokens = std::min(limits_.burst, bucket.tokens + passed_s * limits_.per_second);
  bucket.refilled_ns = now.boottime_ns;
  if (bucket.tokens >= 1) {
    bucket.tokens -= 1;
    return true;
  }
  FoldedAlerts& folded = bucket.folded;
  if (folded.count == 0) {
    folded.first_ns = now.boottime_ns;
    folded.alert = alert;
  }
  ++folded.count;
  folded.last_ns = now.boottime_ns;
  folded.alert.severity = std::max(folded.alert.severity, alert.severity);
  folded.alert.text = alert.text;
  return false;
}

bool AlertLimiter::IsDue(const Bucket& bucket, Instant now) const {
  return bucket.folded.count > 0 && now.boottime_ns - bucket.folded.first_ns >= limits_.summary_ns;
}

std::optional<FoldedAlerts> AlertLimiter::Pop(const std::string& kind, Instant now) {
  const auto it = buckets_.find(kind);
  if (it == buckets_.end() || !IsDue(it->second, now)) return std::nullopt;
  return std::exchange(it->second.folded, {});
}

std::vector<engine::AlertEffect> AlertLimiter::Due(Instant now) {
  std::vector<engine::AlertEffect> due;
  for (auto& [kind, bucket] : buckets_) {
    if (!IsDue(bucket, now)) continue;
    FoldedAlerts folded = std::exchange(bucket.folded, {});
    folded.alert.text = absl::StrCat(folded.count, " more alerts of this ", limits_.kind,
                                     " within ", limits_.within, "; last: ", folded.alert.text);
    due.push_back(std::move(folded.alert));
  }
  return due;
}

}  // namespace rips::pipeline
