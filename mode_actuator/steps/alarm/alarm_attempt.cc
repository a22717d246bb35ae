#include "mode_actuator/steps/alarm/alarm_attempt.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "services/base/clock.h"

namespace rips::actuator {
namespace {

// The same order would fail in the same way.
bool IsForGood(const absl::Status& status) {
  return absl::IsInvalidArgument(status) || absl::IsOutOfRange(status);
}

}  // namespace

AlarmAttempt::AlarmAttempt(const AlarmStep& step, std::string name, Alarms* alarms,
                           const Options& options, int64_t now_ns)
    : step_(step), alarms_(alarms), options_(options), began_ns_(now_ns) {
  result.step = std::move(name);
  See("?");
}

void AlarmAttempt::See(std::string seen) {
  seen_ = std::move(seen);
  observed = absl::StrCat(step_.device, "=", absl::StrReplaceAll(seen_, {{" ", "_"}}));
}

bool AlarmAttempt::Poll(int64_t now_ns) {
  if (finished_) return true;
  if (order_ == 0) {
    if (now_ns >= next_try_ns_) Try(now_ns);
  } else if (std::optional<AlarmResult> ended = alarms_->Poll(order_)) {
    order_ = 0;
    EndTry(*std::move(ended), now_ns);
  } else if (now_ns >= try_end_ns_) {
    alarms_->Drop(std::exchange(order_, 0));
    EndTry({.status = absl::DeadlineExceededError(
                absl::StrCat("not over in ", absl::FormatDuration(options_.timeout)))},
           now_ns);
  }
  return finished_;
}

void AlarmAttempt::Cancel() {
  if (finished_) return;
  if (order_ != 0) alarms_->Drop(std::exchange(order_, 0));
  status = absl::CancelledError("cancelled");
  result.detail = "cancelled";
  finished_ = true;
}

void AlarmAttempt::Try(int64_t now_ns) {
  try_end_ns_ = now_ns + absl::ToInt64Nanoseconds(options_.timeout);
  const absl::StatusOr<uint64_t> order = alarms_->Begin(step_.device, options_.order, step_.state);
  if (order.ok()) {
    order_ = *order;
  } else {
    EndTry({.status = order.status()}, now_ns);
  }
}

void AlarmAttempt::EndTry(AlarmResult ended, int64_t now_ns) {
  status = ended.status;
  See(std::move(ended.observed));
  result.ok = status.ok();
  result.detail = result.ok ? std::move(ended.detail) : std::string(status.message());
  result.took_ms = static_cast<uint32_t>((now_ns - began_ns_) / kNanosPerMilli);
  finished_ = result.ok || ++tries_ > options_.retries || IsForGood(status);
  next_try_ns_ = now_ns + absl::ToInt64Nanoseconds(kAlarmRetryPause);
}

}  // namespace rips::actuator
