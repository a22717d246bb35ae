// Raises RIPS's own alerts that name an attacker of the server, at a limited rate:
//
// | event                                                 | alert                      | severity |
// |-------------------------------------------------------|----------------------------|----------|
// | a connection was ended and banned for what it cost    | once a minute for each     | critical |
// |                                                       | certificate, and for those |          |
// |                                                       | without one                |          |
// | connections make no call (FloodWatch)                 | once a minute an address;  | high     |
// |                                                       | for all others together    |          |
// | peers of a robot send more than can be judged         | once a minute a robot      | high     |
// | a certificate has 20 calls refused within 10 s, for   | once a minute              | high     |
// | its quota or as CallGate refuses them                 |                            |          |
#ifndef RIPS_POLICY_SERVER_SERVER_ATTACK_ALERTS_H_
#define RIPS_POLICY_SERVER_SERVER_ATTACK_ALERTS_H_

#include <limits>
#include <map>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/shard/server_alerts.h"
#include "services/base/clock.h"
#include "services/rpc/connection_guard.h"
#include "services/rpc/flood_watch.h"
#include "services/runtime/mutex.h"

namespace rips {

// Any thread; never blocks on the disk.
class AttackAlerts {
 public:
  // Nothing is owned; all outlive this.
  AttackAlerts(pipeline::ServerAlerts* alerts, const Clock* clock)
      : alerts_(alerts), clock_(clock) {}

  void OnConnectionEnded(const rpc::ConnectionGuard::Report& report) ABSL_LOCKS_EXCLUDED(mu_);
  void OnFlood(const rpc::FloodWatch::Flood& flood);
  // A stream of a peer of this robot, which is of the inventory, was closed.
  void OnPeerRefused(const std::string& robot) ABSL_LOCKS_EXCLUDED(mu_);
  // `identity`: the URI of a certificate; `reason`: `quota`, or one of rpc::Refusal.
  void OnCallRefused(const std::string& identity, absl::string_view reason)
      ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // True once a minute for each name.
  bool IsDue(const std::string& name) ABSL_LOCKS_EXCLUDED(mu_);

  pipeline::ServerAlerts* alerts_;
  const Clock* clock_;
  Mutex mu_;
  std::map<std::string, int64_t> told_ns_ ABSL_GUARDED_BY(mu_);
  rpc::FloodWatch refused_calls_ ABSL_GUARDED_BY(mu_){
      {.of_source = 20, .of_all = std::numeric_limits<int>::max()}};
};

}  // namespace rips

#endif  // RIPS_POLICY_SERVER_SERVER_ATTACK_ALERTS_H_
