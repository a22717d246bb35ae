// The server's own listener: takes connections within limits, hands them to gRPC, and ends those
// that cost more than they bring. gRPC 1.51 alone gives its listener up when descriptors run out,
// and holds endless header blocks and reset streams without bound.
//
//   accepted ──refused by Admission──► reset
//      │
//      ├─taken, address not known──► HandshakeQueue, until it is its turn
//      │                                │
//      └─taken──► watched: calls counted as they begin, messages as handlers read them, bytes as
//                 the kernel counts them ──more than ConnectionBudget allows──► shut down, banned
//                    │
//                    └─closed by gRPC or the peer──► forgotten
//
// gRPC owns the descriptor it was given; the guard keeps a duplicate of its own, for the same
// socket, and closes it when the connection is over.
//
// A ban is of the certificate, which CallGate asks for (Banned), and of the address; of neither if
// ours connect from there and the peer had not named itself. Who has a copy of a certificate's key
// must not shut its owner out: each address at which the certificate is at home (Admission::AtHome)
// has limits of its own, and a ban for what it did elsewhere does not hold there.
#ifndef RIPS_SERVICES_RPC_CONNECTION_GUARD_H_
#define RIPS_SERVICES_RPC_CONNECTION_GUARD_H_

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/container/flat_hash_map.h"
#include "absl/container/flat_hash_set.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "grpcpp/server_builder.h"
#include "grpcpp/server_context.h"
#include "services/base/clock.h"
#include "services/rpc/connection.h"
#include "services/rpc/connection_admission.h"
#include "services/rpc/connection_budget.h"
#include "services/rpc/handshake_queue.h"
#include "services/rpc/identity.h"
#include "services/rpc/socket_activity.h"
#include "services/runtime/log_limiter.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips::rpc {

class ConnectionGuard {
 public:
  // A connection that was ended for what it cost.
  struct Report {
    std::string peer;
    // Empty = not identified.
    std::string certificate;
    // Whose that is.
    std::optional<PeerIdentity> identity;
    Excess excess = Excess::kNone;
    int64_t banned_ns = 0;
  };
  struct Options {
    AdmissionLimits admission;
    BudgetLimits budget;
    // Of addresses that are not known.
    HandshakePace handshakes;
    // Connections of one certificate at each address where it is at home, and at all others. An
    // agent has one, and one that is not over yet.
    int per_operator = 16;
    int per_agent = 4;
    // Calls of one agent's certificate, as above, on all connections: each begins a stream.
    double agent_calls_burst = 40;
    double agent_calls_per_second = 2;
    // Between two looks at the connections, of which those at rest are looked at every fourth time.
    absl::Duration interval = absl::Milliseconds(50);
    // On a thread of the guard or of a call; must not block. May be empty.
    std::function<void(const Report&)> on_ended;
    // Of each connection that came to nothing: refused, ended without a call or to make room, or
    // closed by its peer before it showed a certificate. `known`: a certificate of ours was shown
    // from that address not long ago. Not of those refused for want of descriptors.
    std::function<void(const std::string& address, bool known)> on_wasted;
  };

  // Binds each address of `listen` (`HOST:PORT`, `[HOST]:PORT`; port 0 = any, the same for all).
  // Unavailable if it cannot. `clock` and `metrics` (may be null) are not owned and outlive this.
  static absl::StatusOr<std::unique_ptr<ConnectionGuard>> Listen(const std::string& listen,
                                                                 Options options,
                                                                 const Clock* clock,
                                                                 Metrics* metrics);
  // As Stop.
  ~ConnectionGuard();

  int port() const { return port_; }
  // Once: what is taken goes to `grpc` from now on.
  void Start(std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> grpc);
  // Takes no more connections; those that live go on, unwatched. Idempotent.
  void Stop();

  // Connects to the listener itself. Unavailable if nothing takes the connection in time.
  absl::Status Probe(absl::Duration patience) ABSL_LOCKS_EXCLUDED(mu_);

  // Of this peer, as gRPC names it; null if there is none.
  std::shared_ptr<Connection> Find(absl::string_view peer) ABSL_LOCKS_EXCLUDED(mu_);
  // A call begins. First of all that is done for it.
  void OnCall(const grpc::ServerContextBase& context);
  // The peer's certificate is one of ours. ResourceExhausted if it has so many connections already,
  // or, of an agent, begins so many calls.
  absl::Status OnIdentified(absl::string_view peer, const std::string& certificate, bool agent)
      ABSL_LOCKS_EXCLUDED(mu_);
  // A request could not be decoded, or was reset before it came: more of those than an agent may
  // make calls end the connection and ban the certificate.
  void OnUndecodable(Connection& from, const std::string& certificate) ABSL_LOCKS_EXCLUDED(mu_);
  // How long the certificate is banned still at this address (Source::address); 0 = it is not.
  absl::Duration Banned(const std::string& certificate, const std::string& address)
      ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // Taken, and not handed to gRPC.
  struct Waiting {
    std::shared_ptr<Connection> connection;
    UniqueFd socket;
  };
  struct AgentCalls {
    double tokens = 0;
    int64_t counted_ns = 0;
  };
  // Of a certificate.
  struct Ban {
    // CLOCK_BOOTTIME.
    int64_t until_ns = 0;
    // Its homes for which it holds, too: what it is for was done there.
    std::vector<std::string> homes;
  };

  ConnectionGuard(Options options, const Clock* clock, Metrics* metrics);
  absl::Status Bind(const std::string& listen);
  void Accept();
  // Everything that waits at a listener. False: descriptors have run out.
  bool AcceptAll(int listener);
  void Admit(UniqueFd socket, Source source);
  void HandOverWaiting() ABSL_LOCKS_EXCLUDED(mu_);
  // Ends connections without a certificate that count against the limit `source` has met, so that a
  // flood of those keeps out no peer that would name itself: first of addresses that are not known,
  // of the network that has most, one that has sent nothing, the oldest; one, or one in 64 of many.
  // Returns them; none if too many that gRPC had were ended since the last look.
  std::vector<std::shared_ptr<Connection>> MakeRoomLocked(const Source& source,
                                                          Admission::Verdict limit, int64_t now_ns)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void RunWatch();
  void CheckConnections();
  void ForgetLocked(const Connection& connection) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void EndFor(Connection& connection, Excess excess);
  // Its address, and its certificate if that is known. Returns how long it lasts still.
  int64_t BanLocked(const Connection& connection, int64_t now_ns)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // One that sent enough for a handshake is over, unnamed.
  void LogUnknownPeer(const Connection& connection);
  // A connection of this address came to nothing.
  void Wasted(const Source& source, int64_t now_ns) ABSL_LOCKS_EXCLUDED(mu_);
  // What the limits of a certificate are counted by: itself and its home, if it is at one.
  std::string AccountLocked(const Source& source, const std::string& certificate,
                            int64_t now_ns) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  int64_t BannedLocked(const std::string& certificate, const std::string& address,
                       int64_t now_ns) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool MayCallLocked(const std::string& account, int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const Options options_;
  const Clock* clock_;
  Metrics* metrics_;
  Gauge open_;
  int port_ = 0;
  std::vector<UniqueFd> listeners_;
  // Given up for a moment when descriptors run out, so that what waits can be refused.
  UniqueFd reserve_;
  const WakeFd wake_;
  std::unique_ptr<grpc::experimental::ExternalConnectionAcceptor> grpc_;

  LogLimiter refusal_logs_;
  LogLimiter unknown_peer_logs_;
  Mutex mu_;
  CondVar stop_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  Admission admission_ ABSL_GUARDED_BY(mu_);
  // Of those below.
  SocketActivity activity_;
  // By peer.
  absl::flat_hash_map<std::string, std::shared_ptr<Connection>> connections_ ABSL_GUARDED_BY(mu_);
  HandshakeQueue<Waiting> waiting_ ABSL_GUARDED_BY(mu_);
  // Connections that were identified, by account.
  absl::flat_hash_map<std::string, int> accounts_ ABSL_GUARDED_BY(mu_);
  // Connections ended since the last look to make room for others.
  int made_room_ ABSL_GUARDED_BY(mu_) = 0;
  // By account.
  absl::flat_hash_map<std::string, AgentCalls> agent_calls_ ABSL_GUARDED_BY(mu_);
  // Peers that are Probe.
  absl::flat_hash_set<std::string> probes_ ABSL_GUARDED_BY(mu_);
  // By certificate.
  std::map<std::string, Ban> banned_ ABSL_GUARDED_BY(mu_);
  // When those that were connected were last noted as known.
  int64_t stayed_ns_ ABSL_GUARDED_BY(mu_) = 0;
  // Memory that ended connections held is given back then; 0 = nothing to give.
  int64_t trim_at_ns_ ABSL_GUARDED_BY(mu_) = 0;
  std::atomic<bool> stopped_ = false;
  std::thread accept_;
  std::thread watch_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_CONNECTION_GUARD_H_
