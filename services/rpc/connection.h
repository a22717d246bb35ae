// One connection, as ConnectionGuard keeps it.
#ifndef RIPS_SERVICES_RPC_CONNECTION_H_
#define RIPS_SERVICES_RPC_CONNECTION_H_

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "grpcpp/security/auth_context.h"
#include "services/rpc/connection_admission.h"
#include "services/rpc/connection_budget.h"
#include "services/rpc/peer.h"
#include "services/runtime/mutex.h"
#include "services/runtime/unique_fd.h"

namespace rips::rpc {

// That gRPC was given. Any thread.
class Connection {
 public:
  // `watched`: SocketActivity tells of it.
  Connection(Source source, UniqueFd socket, bool watched, const BudgetLimits& limits,
             int64_t now_ns)
      : source_(std::move(source)),
        taken_ns_(now_ns),
        socket_(std::move(socket)),
        budget_(limits, now_ns),
        look_{.watched = watched} {}

  // A handler has received a message of so many bytes.
  void OnMessage(size_t bytes) ABSL_LOCKS_EXCLUDED(mu_);
  // A handler has refused a message, which none of ours sends: the connection is ended soon, and
  // its certificate banned.
  void OnRefused() ABSL_LOCKS_EXCLUDED(mu_) { Exceed(Excess::kRefused); }
  // The peer's certificate: `spiffe://td/robot/r1/sensor/base serial 0f3a`, and what its limits are
  // counted by. The first one counts.
  void Identify(const std::string& certificate, const std::string& account, bool agent)
      ABSL_LOCKS_EXCLUDED(mu_);
  const Source& source() const { return source_; }
  // PeerOf, once: on a connection the certificate stays, and reading it is dear.
  absl::StatusOr<Peer> ReadPeer(const grpc::AuthContext& auth) ABSL_LOCKS_EXCLUDED(mu_);
  // A call was refused for what its certificate did. From the second time on it is ended: it was
  // told why, and each answer costs others.
  void OnThrottled() ABSL_LOCKS_EXCLUDED(mu_);

 private:
  friend class ConnectionGuard;
  enum class State { kOpen, kOver, kEnded };
  // The last time that the kernel was asked; `unsent`: the peer had not taken what it was sent.
  struct Look {
    bool watched = false;
    bool unsent = false;
    int64_t at_ns = 0;
  };

  Excess OnCall(int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  void Exceed(Excess why) ABSL_LOCKS_EXCLUDED(mu_);
  // What the kernel says of the socket. Without activity it is asked only after `rest_ns`, or while
  // its peer does not read.
  State Check(int64_t now_ns, bool active, int64_t rest_ns, Excess& excess)
      ABSL_LOCKS_EXCLUDED(mu_);
  bool EndedByPeer() const ABSL_LOCKS_EXCLUDED(mu_);
  bool End() ABSL_LOCKS_EXCLUDED(mu_);
  // The one it was admitted with; empty = none.
  std::string certificate() const ABSL_LOCKS_EXCLUDED(mu_);
  std::string account() const ABSL_LOCKS_EXCLUDED(mu_);
  // That, or the one that ReadPeer has read, admitted or not.
  std::string shown() const ABSL_LOCKS_EXCLUDED(mu_);
  // Whose ReadPeer has read it to be.
  std::optional<PeerIdentity> identity() const ABSL_LOCKS_EXCLUDED(mu_);

  const Source source_;
  const int64_t taken_ns_;
  const UniqueFd socket_;
  // OnThrottled has been called.
  std::atomic<bool> told_ = false;
  // It has sent enough to be a peer of ours.
  std::atomic<bool> spoke_ = false;
  mutable Mutex mu_;
  ConnectionBudget budget_ ABSL_GUARDED_BY(mu_);
  std::string certificate_ ABSL_GUARDED_BY(mu_);
  std::string account_ ABSL_GUARDED_BY(mu_);
  std::optional<Peer> peer_ ABSL_GUARDED_BY(mu_);
  bool ended_ ABSL_GUARDED_BY(mu_) = false;
  Look look_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_CONNECTION_H_
