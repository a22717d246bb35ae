#include "policy_server/server/robot/context/evidence_gate.h"

#include <utility>

#include "absl/strings/str_format.h"

namespace rips::pipeline {
namespace {

constexpr int64_t kNanosPerTenth = kNanosPerSecond / 10;

}  // namespace

void EvidenceGate::Update(std::vector<std::string> problems, bool level_verified, Instant now) {
  problems_ = std::move(problems);
  if (!problems_.empty()) Disturb(problems_.front(), now);
  if (level_verified) return;
  problems_.emplace_back("the last level is not verified");
  clear_since_ns_ = now.boottime_ns;
  disturbed_by_ = problems_.front();
}

void EvidenceGate::Disturb(const std::string& why, Instant now) {
  clear_since_ns_ = now.boottime_ns;
  disturbed_by_ = broken_by_ = why;
}

void EvidenceGate::Restart(Instant now) {
  clear_since_ns_ = now.boottime_ns;
  disturbed_by_ = "the level has changed";
  broken_by_.clear();
}

levels::Evidence EvidenceGate::Assess(Instant now) const {
  if (!problems_.empty()) return {.blind_because = problems_};
  const int64_t clear_ns = now.boottime_ns - clear_since_ns_;
  if (clear_ns >= hold_ns_) return {};
  return {.blind_because = {
              // Rounded down: it never says that the hold is over.
              absl::StrFormat("evidence has been complete for only %.1f s of %.1f s; before: %s",
                              static_cast<double>(clear_ns / kNanosPerTenth) / 10,
                              static_cast<double>(hold_ns_) / kNanosPerSecond, disturbed_by_)}};
}

}  // namespace rips::pipeline
