// Decides whether a peer is served: who it is, whether its certificate still counts, and what it is
// refused for. Asked at each call, and again and again for live streams (SessionWatch).
#ifndef RIPS_SERVICES_RPC_CALL_GATE_H_
#define RIPS_SERVICES_RPC_CALL_GATE_H_

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "grpcpp/server_context.h"
#include "services/base/clock.h"
#include "services/rpc/connection_guard.h"
#include "services/rpc/peer.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

// Label values of rips_refused_calls_total.
//
// | reason        | status            | when                                                     |
// |---------------|-------------------|----------------------------------------------------------|
// | unidentified  | UNAUTHENTICATED   | no certificate, or none with one URI of ours             |
// | expired       | UNAUTHENTICATED   | after notAfter, by the wall clock                         |
// | revoked       | UNAUTHENTICATED   | on a revocation list                                     |
// | banned        | PERMISSION_DENIED | on the deny list                                         |
// | role          | PERMISSION_DENIED | not what the call is for                                 |
// | claim         | PERMISSION_DENIED | says that it is another agent                            |
// | limit         | INVALID_ARGUMENT  | a field of its request is past its limit                 |
// | undecodable   | UNIMPLEMENTED     | its request is no message, a text in it not UTF-8, or it |
// |               |                   | was reset before: gRPC ends the call, no handler is asked|
// | throttled     | RESOURCE_EXHAUSTED| its connections broke the limits, or are too many        |
// | quota         | RESOURCE_EXHAUSTED| an operator's certificate asks more than it may          |
inline constexpr absl::string_view kRefusalReasons[] = {
    "unidentified", "expired", "revoked",     "banned",    "role",
    "claim",        "limit",   "undecodable", "throttled", "quota"};
struct Refusal {
  const char* reason;
  absl::Status status;
};

// Any thread.
class CallGate {
 public:
  // Why the peer is not served, besides its expiry; nullopt = nothing against it. Any thread.
  using Judge = std::function<std::optional<Refusal>(const Peer&)>;

  // Nothing is owned; all outlive this. `metrics` and `connections` may be null.
  CallGate(const Clock* clock, Judge judge, Metrics* metrics,
           ConnectionGuard* connections = nullptr);

  // Called with each peer that Admit lets pass, on the call's thread. Before the first call.
  void set_on_admitted(std::function<void(const Peer&)> admitted) {
    on_admitted_ = std::move(admitted);
  }

  // Called with each refusal of a peer that is known, on the call's thread. Before the first call.
  using OnRefused = std::function<void(const Peer&, const Refusal&, absl::string_view address)>;
  void set_on_refused(OnRefused refused) { on_refused_ = std::move(refused); }

  // Why the peer's certificate does not count any more. Not whether it does yet: the handshake has
  // seen to that, and a clock that is set back later must not end what was good.
  std::optional<Refusal> Against(const Peer& peer) const;
  // The peer of a call for which it must have `role`. What is refused is counted and logged.
  absl::StatusOr<Peer> Admit(const grpc::CallbackServerContext& context, Role role);
  // Counts and logs a call whose request gRPC could not decode, and tells `connections` of it.
  void RefuseUndecodable(const grpc::ServerContextBase& context);
  // Null if connections are not guarded.
  std::shared_ptr<Connection> ConnectionOf(absl::string_view peer) {
    return connections_ == nullptr ? nullptr : connections_->Find(peer);
  }
  // Counts and logs (each reason and role once a second at most) a refusal, and returns its status.
  // `peer` null = not known; `address` empty = not known.
  absl::Status Refuse(const Refusal& refusal, const Peer* peer, absl::string_view address)
      ABSL_LOCKS_EXCLUDED(mu_);

 private:
  void Count(absl::string_view reason, absl::string_view role, double by);

  const Clock* clock_;
  const Judge judge_;
  Metrics* metrics_;
  ConnectionGuard* connections_;
  std::function<void(const Peer&)> on_admitted_;
  OnRefused on_refused_;
  Mutex mu_;
  // By role and reason: when it was logged last, and how often it was not since.
  std::map<std::pair<std::string, std::string>, std::pair<int64_t, uint64_t>> logged_
      ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_CALL_GATE_H_
