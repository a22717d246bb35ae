// Robot: what was not judged or not inspected, told with counts and not for each.
#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/robot/robot.h"
#include "services/base/saturating.h"

namespace rips::pipeline {

void Robot::TellLosses(Instant now) {
  if (const auto news = loss_alarm_.Due(now.boottime_ns)) OwnAlert(news->severity, news->text);
}

void Robot::TellStoreWentBack(const std::string& how) {
  evidence_.Disturb("the store is older than what sensors were told is durable",
                    ports_.clock->Now());
  if (std::exchange(told_.store_went_back, true)) return;
  OwnAlert(engine::Severity::kCritical,
           absl::StrCat(how, ": a backup was restored; what was judged in between is not judged ",
                        "again, and its alerts and decisions are not in this store; bans and the ",
                        "count of soft lowerings are those of the backup"));
}

// Of each range, `judged` from the store, `acknowledged` and `first` as the sensor says:
//   first <= judged + 1                    nothing is missing
//   acknowledged <= judged < first - 1     lost: dropped by the sensor before it was acknowledged
//   judged < acknowledged                  the store went back; lost, once, only what lies above
//   of a former process of the sensor,     it names a point that the store does not go on from: not
//   nothing acknowledged                   lost, once; what it was told ended with that process
// An excuse is for what lies before the first hello to this process of the server: the sensor is
// told of our generation in answer, and one that names another again has lost what is missing.
uint64_t Robot::LostBefore(SensorHost& host, const SensorHello& hello) {
  const bool parted = !ports_.recorder->GoesOnFrom(hello.store);
  if (parted) {
    TellStoreWentBack(absl::StrCat("the store is older than what sensor ", host.name,
                                   " was told is durable, or another one (",
                                   store::ToString(hello.store), "; the store holds ",
                                   store::ToString(ports_.recorder->point()), ")"));
  }
  bool went_back = parted;
  for (const SpooledRange& range : hello.spooled) {
    const uint64_t judged = host.sequences.Judged(range.incarnation, range.lane);
    if (range.acknowledged > judged) {
      went_back = true;
      TellStoreWentBack(absl::StrCat("the store is older than what sensor ", host.name,
                                     " was told is durable (", range.acknowledged,
                                     ", the store knows ", judged, ")"));
    }
  }
  // Once, or a sensor could hide any gap by its word.
  const bool excuse = went_back && !std::exchange(host.excused, true);
  uint64_t lost = 0;
  for (const SpooledRange& range : hello.spooled) {
    const uint64_t judged = host.sequences.Judged(range.incarnation, range.lane);
    const uint64_t known = excuse ? std::max(judged, range.acknowledged) : judged;
    const bool excused =
        excuse && parted && range.acknowledged == 0 && range.incarnation != hello.incarnation;
    if (!excused && range.first_sequence > known + 1) {
      lost = SaturatingAdd(lost, range.first_sequence - known - 1);
    }
    // Older incarnations that are announced are not the ones to be forgotten.
    host.sequences.Restore(range.incarnation, range.lane, range.first_sequence - 1);
  }
  return lost;
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
