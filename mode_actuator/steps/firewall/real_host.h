// This host's addresses and gateways, and the servers of actuator.yaml as addresses.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_REAL_HOST_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_REAL_HOST_H_

#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/firewall/host_view.h"
#include "services/runtime/mutex.h"
#include "services/runtime/ticker.h"

namespace rips::actuator {

// Names of servers are looked up again this often.
inline constexpr absl::Duration kResolveEvery = absl::Seconds(30);

// `HOST:PORT` with a numeric host, an IPv6 one in brackets. NotFound if the host is a name,
// InvalidArgument if it is no HOST:PORT.
absl::StatusOr<ControlAddress> ParseNumericServer(absl::string_view server);

// The next hops of default routes in the texts of /proc/net/route and /proc/net/ipv6_route.
std::vector<std::string> DefaultGateways(absl::string_view route, absl::string_view ipv6_route);

// Names are resolved on a thread of its own, since that may take long, also while a level's rules
// keep name servers away; an address once known is kept, at most kControlMax in all.
class RealHost final : public HostView {
 public:
  // `servers` as in actuator.yaml: checked already.
  explicit RealHost(std::vector<std::string> servers);

  absl::StatusOr<std::vector<ControlAddress>> Control() override ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<KeptOpen> Kept() override;

 private:
  void Resolve(const std::string& server) ABSL_LOCKS_EXCLUDED(mu_);

  const std::vector<std::string> servers_;
  Mutex mu_;
  std::set<ControlAddress> known_ ABSL_GUARDED_BY(mu_);
  // Names never resolved so far, and why.
  std::map<std::string, std::string> missing_ ABSL_GUARDED_BY(mu_);
  std::optional<Ticker> ticker_;  // only if there are names; its end waits for a look-up under way
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_REAL_HOST_H_
