#include "services/runtime/await.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"

namespace rips {
namespace {

constexpr absl::Duration kFirstPause = absl::Seconds(1);
constexpr absl::Duration kPauseMax = absl::Seconds(10);

}  // namespace

bool RepeatFilter::Pass(absl::string_view message, int64_t now_boottime_ns) {
  if (last_ == message && now_boottime_ns < again_ns_) return false;
  last_ = std::string(message);
  again_ns_ = now_boottime_ns + absl::ToInt64Nanoseconds(kAgain);
  return true;
}

absl::Status Await(absl::string_view what, const std::function<absl::Status()>& attempt,
                   const std::function<bool(absl::Duration)>& pause) {
  RepeatFilter filter;
  absl::Duration delay = kFirstPause;
  while (true) {
    const absl::Status status = attempt();
    if (status.ok() || absl::IsPermissionDenied(status)) {
      if (status.ok() && filter.said()) LogInfo(absl::StrCat("no longer waiting for ", what));
      return status;
    }
    if (filter.Pass(status.message(), BoottimeNow())) {
      LogError(absl::StrCat("waiting for ", what), {{"reason", status.message()}});
    }
    if (pause(delay)) return absl::CancelledError("ended while waiting");
    delay = std::min(2 * delay, kPauseMax);
  }
}

}  // namespace rips
