#include "policy_server/server/outputs/delivery_health.h"

#include "absl/strings/str_cat.h"
#include "services/runtime/log.h"

namespace rips::outputs {

void DeliveryHealth::OnFailed(int64_t now_ns, absl::string_view reason) {
  reason_ = std::string(reason);
  if (failing_since_ns_.has_value()) return;
  failing_since_ns_ = now_ns;
  LogWarning("output cannot deliver alerts; retrying", {{"output", what_}, {"reason", reason}});
}

void DeliveryHealth::OnAccepted(int64_t now_ns) {
  if (!failing_since_ns_.has_value()) return;
  const int64_t seconds = (now_ns - *failing_since_ns_) / kNanosPerSecond;
  failing_since_ns_.reset();
  LogInfo("output delivers alerts again", {{"output", what_}, {"after_seconds", seconds}});
  if (!reported_) return;
  reported_ = false;
  alert_(engine::Severity::kInfo,
         absl::StrCat(what_, " delivers alerts again, after ", seconds, " s"));
}

void DeliveryHealth::Poll(int64_t now_ns, uint64_t behind) {
  if (reported_ || !failing_since_ns_.has_value() || now_ns - *failing_since_ns_ < kTroubleNs) {
    return;
  }
  reported_ = true;
  alert_(
      engine::Severity::kHigh,
      absl::StrCat(what_, " has delivered no alert for ",
                   (now_ns - *failing_since_ns_) / kNanosPerSecond, " s: ", reason_, "; ", behind,
                   " alerts of any robot and severity are behind it in the store; its "
                   "own are sent when it works again"));
}

}  // namespace rips::outputs
