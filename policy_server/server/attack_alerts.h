// Raises RIPS's own alerts that name an attacker of the server, at a limited rate:
//
// | event                                               | alert                      | severity |
// |-----------------------------------------------------|----------------------------|----------|
// | a connection was ended and banned for what it cost  | once a minute for each     | critical |
// |                                                     | certificate, and for those |          |
// |                                                     | without one                |          |
// | connections make no call: 64 within 10 s from one   | as FloodWatch reports      | high     |
// | address, or 512 from all                            |                            |          |
// | calls of one certificate are refused: 20 within     | as FloodWatch reports      | high     |
// | 10 s, for its quota or as CallGate refuses them     |                            |          |
// | peers of a robot send more than can be judged       | once a minute a robot      | high     |
//
// Of the first and the third, if an agent's key was used, its robot is told (OnKeyMisused), so that
// it doubts what the agent says.
#ifndef RIPS_POLICY_SERVER_SERVER_ATTACK_ALERTS_H_
#define RIPS_POLICY_SERVER_SERVER_ATTACK_ALERTS_H_

#include <functional>
#include <limits>
#include <map>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/flood_watch.h"
#include "policy_server/server/shard/server_alerts.h"
#include "services/base/clock.h"
#include "services/rpc/connection_guard.h"
#include "services/rpc/identity.h"
#include "services/runtime/mutex.h"

namespace rips {

// Any thread; never blocks on the disk.
class AttackAlerts {
 public:
  // An agent's key was used from `peer` for what no agent does; once in kMisuseEveryNs an agent.
  using OnKeyMisused = std::function<void(const rpc::PeerIdentity& agent, const std::string& peer)>;
  static constexpr int64_t kMisuseEveryNs = 5 * kNanosPerSecond;

  // Nothing is owned; all outlive this. `on_key_misused` may be empty.
  AttackAlerts(pipeline::ServerAlerts* alerts, const Clock* clock,
               OnKeyMisused on_key_misused = nullptr)
      : alerts_(alerts), clock_(clock), on_key_misused_(std::move(on_key_misused)) {}

  void OnConnectionEnded(const rpc::ConnectionGuard::Report& report) ABSL_LOCKS_EXCLUDED(mu_);
  // As ConnectionGuard::Options::on_wasted.
  void OnConnectionWasted(const std::string& address, bool known) ABSL_LOCKS_EXCLUDED(mu_);
  // A stream of a peer of this robot, which is of the inventory, was closed.
  void OnPeerRefused(const std::string& robot) ABSL_LOCKS_EXCLUDED(mu_);
  // `reason`: of rpc::Refusal; `address` as gRPC names the peer, or empty.
  void OnCallRefused(const rpc::PeerIdentity& identity, absl::string_view reason,
                     absl::string_view address) ABSL_LOCKS_EXCLUDED(mu_);
  // Call it every second or so: reports the minute that has passed.
  void Poll() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void KeyMisused(const rpc::PeerIdentity& identity, const std::string& peer)
      ABSL_LOCKS_EXCLUDED(mu_);
  // True once a minute for each name.
  bool IsDue(const std::string& name) ABSL_LOCKS_EXCLUDED(mu_);
  void ReportConnections(const FloodWatch::Report& report);
  void ReportCalls(const FloodWatch::Report& report);

  pipeline::ServerAlerts* alerts_;
  const Clock* clock_;
  const OnKeyMisused on_key_misused_;
  Mutex mu_;
  // By agent. There is no end to their number but that of the certificates that we issue.
  std::map<std::string, int64_t> misused_ns_ ABSL_GUARDED_BY(mu_);
  std::map<std::string, int64_t> told_ns_ ABSL_GUARDED_BY(mu_);
  FloodWatch connections_ ABSL_GUARDED_BY(mu_){FloodWatch::Limits{}};
  // Certificates are ours, so there are no decoys without end.
  FloodWatch calls_ ABSL_GUARDED_BY(mu_){{.of_source = 20,
                                          .of_all = std::numeric_limits<int>::max(),
                                          .named = 256,
                                          .gravest_first = true}};
};

}  // namespace rips

#endif  // RIPS_POLICY_SERVER_SERVER_ATTACK_ALERTS_H_
