#include "policy_server/server/robot/context/alert_limiter.h"

#include <algorithm>

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
  if (bucket.folded == 0) {
    bucket.folded_since_ns = now.boottime_ns;
    bucket.last = alert;
  }
  ++bucket.folded;
  bucket.last.severity = std::max(bucket.last.severity, alert.severity);
  bucket.last.text = alert.text;
  return false;
}

std::vector<engine::AlertEffect> AlertLimiter::Due(Instant now) {
  std::vector<engine::AlertEffect> due;
  for (auto& [kind, bucket] : buckets_) {
    if (bucket.folded == 0 || now.boottime_ns - bucket.folded_since_ns < limits_.summary_ns) {
      continue;
    }
    engine::AlertEffect summary = bucket.last;
    summary.text = absl::StrCat(bucket.folded, " more alerts of this ", limits_.kind, " within ",
                                limits_.within, "; last: ", bucket.last.text);
    due.push_back(std::move(summary));
    bucket.folded = 0;
  }
  return due;
}

}  // namespace rips::pipeline
