// Robot: what was not judged or not inspected, told with counts and not for each.
#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/pipeline/robot.h"

namespace rips::pipeline {

void Robot::TellLosses(Instant now) {
  if (const auto news = loss_alarm_.Due(now.boottime_ns)) OwnAlert(news->severity, news->text);
}

// `judged` from the store, `acknowledged` and `first` as the sensor says:
//   first <= judged + 1                    nothing is missing
//   acknowledged <= judged < first - 1     lost: dropped by the sensor before it was acknowledged
//   judged < acknowledged                  the store went back; lost is only what lies above
uint64_t Robot::LostBefore(const SensorHost& host, const SpooledRange& range) {
  const uint64_t judged = host.sequences.Judged(range.incarnation, range.lane);
  if (range.acknowledged > judged) {
    evidence_.Disturb("the store is older than what sensors were told is durable",
                      ports_.clock->Now());
    if (!std::exchange(store_went_back_, true)) {
      OwnAlert(engine::Severity::kCritical,
               absl::StrCat("the store is older than what sensor ", host.name,
                            " was told is durable (", range.acknowledged, ", the store knows ",
                            judged, "): a backup was restored; what was judged in between is not ",
                            "judged again, and its alerts and decisions are not in this store"));
    }
  }
  const uint64_t known = std::max(judged, range.acknowledged);
  return range.first_sequence > known + 1 ? range.first_sequence - known - 1 : 0;
}

void Robot::CountSkipped(const MessageSeen& message, uint64_t inspections) {
  if (inspections == 0) return;
  const auto& [no_payload, cut_payload, not_answered] = kSkipReasons;
  const char* reason = not_answered;
  if (message.truncated) reason = message.payload.empty() ? no_payload : cut_payload;
  skipped_[reason].Add(inspections, ports_.clock->Now().boottime_ns);
  if (ports_.counts.inspections_skipped) ports_.counts.inspections_skipped(reason, inspections);
}

absl::btree_map<std::string, uint64_t> Robot::Skipped() const {
  const Instant now = ports_.clock->Now();
  absl::btree_map<std::string, uint64_t> out;
  for (const auto& [reason, recent] : skipped_) {
    if (const uint64_t total = recent.Total(now.boottime_ns); total > 0) out[reason] = total;
  }
  return out;
}

// Without counts, so that the status does not change with each message.
std::string Robot::SkippedText(Instant now) const {
  std::vector<std::string> reasons;
  for (const auto& [reason, recent] : skipped_) {
    if (recent.Total(now.boottime_ns) > 0) reasons.push_back(reason);
  }
  if (reasons.empty()) return "";
  return absl::StrCat("messages were not inspected in the last ten minutes: ",
                      absl::StrJoin(reasons, ", "), "; see `ripsctl robot coverage`");
}

}  // namespace rips::pipeline
