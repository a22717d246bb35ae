// Makes lasting trouble of an output an event: one high alert when it has not delivered for five
// minutes, and one of severity info when it works again.
//
//   state     a delivery fails             one is accepted    five minutes after the first failure
//   working   failing; log                 -                  -
//   failing   -                            working; log       trouble: alert
//   trouble   -                            working: alert     -
//
// The alerts themselves go through the same store to all outputs. They cause no further ones: a
// change of state needs a delivery that is accepted and then five minutes without one. Pure but for
// the log.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_DELIVERY_HEALTH_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_DELIVERY_HEALTH_H_

#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/state/effect.h"
#include "services/base/clock.h"

namespace rips::outputs {

// Times are of CLOCK_BOOTTIME. One thread at a time.
class DeliveryHealth {
 public:
  static constexpr int64_t kTroubleNs = 300 * kNanosPerSecond;
  using Alert = std::function<void(engine::Severity, const std::string&)>;

  // `what`: output `pager` (webhook).
  DeliveryHealth(std::string what, Alert alert)
      : what_(std::move(what)), alert_(std::move(alert)) {}

  void OnFailed(int64_t now_ns, absl::string_view reason);
  void OnAccepted(int64_t now_ns);
  // Reports trouble when it is time. `behind`: alerts that wait.
  void Poll(int64_t now_ns, uint64_t behind);
  bool working() const { return !failing_since_ns_.has_value(); }

 private:
  const std::string what_;
  const Alert alert_;
  std::optional<int64_t> failing_since_ns_;
  bool reported_ = false;
  // The newest.
  std::string reason_;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_DELIVERY_HEALTH_H_
