#include "policy_server/server/robot/sensors/losses.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "services/base/saturating.h"

namespace rips::pipeline {

void Losses::Report() {
  if (const auto news = alarm_.Due(context_.now_ns())) alerts_.Raise(news->severity, news->text);
}

void Losses::Count(SensorHost& host, uint64_t count) {
  if (count == 0) return;
  context_.Count(Counter::kObservationsLost, count);
  host.losses.Add(count, context_.now_ns());
}

void Losses::OnMissing(SensorHost& host, uint64_t count) {
  Count(host, count);
  alarm_.Add("they have a number and did not come", count, context_.now_ns());
  evidence_.Disturb(absl::StrCat(count, " observations have a number and did not come"),
                    context_.now());
  context_.events.push_back(model::Loss{.count = count});
}

void Losses::OnLoss(SensorHost& host, const LossSeen& loss) {
  Count(host, loss.count);
  if (loss.tolerable) return;
  alarm_.Add(loss.cause, loss.count, context_.now_ns());
  evidence_.Disturb(absl::StrCat(loss.count, " observations were lost: ", loss.cause),
                    context_.now());
}

void Losses::OnStoreWentBack(const std::string& how) {
  evidence_.Disturb("the store is older than what sensors were told is durable", context_.now());
  if (std::exchange(store_went_back_, true)) return;
  alerts_.Raise(
      engine::Severity::kCritical,
      absl::StrCat(how, ": a backup was restored; what was judged in between is not judged ",
                   "again, and its alerts and decisions are not in this store; bans and the ",
                   "count of soft lowerings are those of the backup"));
}

uint64_t Losses::LostBefore(SensorHost& host, const input::SensorHello& in) {
  const SensorHello& hello = in.hello;
  const bool parted = !in.store_goes_on;
  if (parted) {
    OnStoreWentBack(absl::StrCat(
        "the store is older than what sensor ", host.name, " was told is durable, or another one (",
        store::ToString(hello.store), "; the store holds ", store::ToString(in.store), ")"));
  }
  bool went_back = parted;
  for (const SpooledRange& range : hello.spooled) {
    host.sequences.Announce(range.incarnation);
    const uint64_t judged = host.sequences.Judged(range.incarnation, range.lane);
    if (range.acknowledged > judged) {
      went_back = true;
      OnStoreWentBack(absl::StrCat("the store is older than what sensor ", host.name,
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

void Losses::OnSkipped(const MessageSeen& message, uint64_t inspections) {
  if (inspections == 0) return;
  const auto& [no_payload, cut_payload, not_answered] = kSkipReasons;
  const char* reason = not_answered;
  const bool cut =
      message.truncated || message.payload.size() > context_.watch.PayloadBytes(message.topic);
  if (cut) reason = message.payload.empty() ? no_payload : cut_payload;
  skipped_[reason].Add(inspections, context_.now_ns());
  context_.Do(action::CountSkipped{.reason = reason, .inspections = inspections});
}

absl::btree_map<std::string, uint64_t> Losses::Skipped() const {
  absl::btree_map<std::string, uint64_t> out;
  for (const auto& [reason, recent] : skipped_) {
    if (const uint64_t total = recent.Total(context_.now_ns()); total > 0) out[reason] = total;
  }
  return out;
}

// Without counts, so that the status does not change with each message.
std::string Losses::SkippedText() const {
  std::vector<std::string> reasons;
  for (const auto& [reason, total] : Skipped()) reasons.push_back(reason);
  if (reasons.empty()) return "";
  return absl::StrCat("messages were not inspected in the last ten minutes: ",
                      absl::StrJoin(reasons, ", "), "; see `ripsctl robot coverage`");
}

}  // namespace rips::pipeline
