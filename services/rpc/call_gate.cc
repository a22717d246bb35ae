#include "services/rpc/call_gate.h"

#include <memory>

#include "absl/strings/str_cat.h"
#include "services/runtime/log.h"

namespace rips::rpc {

CallGate::CallGate(const Clock* clock, Judge judge, Metrics* metrics, ConnectionGuard* connections)
    : clock_(clock), judge_(std::move(judge)), metrics_(metrics), connections_(connections) {
  // There from the start, so that a first refusal is an increase.
  for (const absl::string_view reason : kRefusalReasons) {
    for (const Role role : {Role::kSensor, Role::kActuator, Role::kOperator, Role::kEnrolment}) {
      Count(reason, RoleName(role), 0);
    }
  }
}

void CallGate::Count(absl::string_view reason, absl::string_view role, double by) {
  if (metrics_ == nullptr) return;
  metrics_
      ->AddCounter("rips_refused_calls_total",
                   "Calls and streams of a peer that were refused, by why.",
                   {{"reason", std::string(reason)}, {"role", std::string(role)}})
      .Increment(by);
}

std::optional<Refusal> CallGate::Against(const Peer& peer) const {
  const absl::Time now = absl::FromUnixNanos(clock_->Now().unix_ns);
  if (now > peer.not_after) {
    return Refusal{"expired", absl::UnauthenticatedError("the certificate has expired")};
  }
  return judge_ ? judge_(peer) : std::nullopt;
}

absl::StatusOr<Peer> CallGate::Admit(const grpc::CallbackServerContext& context, Role role) {
  const std::string address = context.peer();
  const std::shared_ptr<Connection> connection =
      connections_ == nullptr ? nullptr : connections_->Find(address);
  absl::StatusOr<Peer> peer = connection == nullptr ? PeerOf(*context.auth_context())
                                                    : connection->ReadPeer(*context.auth_context());
  if (!peer.ok()) return Refuse({"unidentified", peer.status()}, nullptr, address);
  if (peer->identity.role != role) {
    const std::string text =
        absl::StrCat("the certificate is not ", role == Role::kSensor ? "a " : "an ",
                     RoleName(role), "'s: ", ToString(peer->identity));
    return Refuse({"role", absl::PermissionDeniedError(text)}, &*peer, address);
  }
  if (const auto refusal = Against(*peer)) return Refuse(*refusal, &*peer, address);
  if (connections_ != nullptr) {
    const std::string certificate = Describe(*peer);
    const absl::Duration left = connections_->Banned(
        certificate, connection == nullptr ? std::string() : connection->source().address);
    if (left > absl::ZeroDuration()) {
      const std::string text =
          absl::StrCat("a connection with this certificate broke the limits; try again in ",
                       absl::FormatDuration(absl::Ceil(left, absl::Seconds(1))));
      if (connection != nullptr) connection->OnThrottled();
      return Refuse({"throttled", absl::ResourceExhaustedError(text)}, &*peer, address);
    }
    const bool agent = role == Role::kSensor || role == Role::kActuator;
    absl::Status status = connections_->OnIdentified(address, certificate, agent);
    if (!status.ok()) {
      if (connection != nullptr) connection->OnThrottled();
      return Refuse({"throttled", std::move(status)}, &*peer, address);
    }
  }
  if (on_admitted_) on_admitted_(*peer);
  return peer;
}

void CallGate::RefuseUndecodable(const grpc::ServerContextBase& context) {
  const std::string address = context.peer();
  const std::shared_ptr<Connection> connection = ConnectionOf(address);
  const auto auth = context.auth_context();
  absl::StatusOr<Peer> peer = absl::UnauthenticatedError("no certificate");
  if (auth != nullptr) peer = connection == nullptr ? PeerOf(*auth) : connection->ReadPeer(*auth);
  if (connection != nullptr && peer.ok()) {
    connections_->OnUndecodable(*connection, Describe(*peer));
  }
  const absl::Status status = absl::UnimplementedError("the request cannot be decoded");
  Refuse({"undecodable", status}, peer.ok() ? &*peer : nullptr, address).IgnoreError();
}

absl::Status CallGate::Refuse(const Refusal& refusal, const Peer* peer, absl::string_view address) {
  const std::string role = peer == nullptr ? "unknown" : std::string(RoleName(peer->identity.role));
  Count(refusal.reason, role, 1);
  if (peer != nullptr && on_refused_) on_refused_(*peer, refusal, address);
  uint64_t unlogged = 0;
  {
    MutexLock lock(&mu_);
    const int64_t now_ns = clock_->Now().boottime_ns;
    const auto [at, fresh] = logged_.try_emplace({role, refusal.reason}, now_ns, 0);
    if (!fresh && now_ns - at->second.first < kNanosPerSecond) {
      ++at->second.second;
      return refusal.status;
    }
    unlogged = at->second.second;
    at->second = {now_ns, 0};
  }
  LogWarning("refused", {{"reason", refusal.reason},
                         {"peer", peer == nullptr ? "unknown" : Describe(*peer)},
                         {"address", address},
                         {"status", refusal.status.ToString()},
                         {"more_not_logged", unlogged}});
  return refusal.status;
}

}  // namespace rips::rpc
