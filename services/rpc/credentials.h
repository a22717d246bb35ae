// Mutual TLS 1.3 from files, with identities checked while the connection is made.
#ifndef RIPS_SERVICES_RPC_CREDENTIALS_H_
#define RIPS_SERVICES_RPC_CREDENTIALS_H_

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "grpcpp/security/credentials.h"
#include "grpcpp/security/server_credentials.h"
#include "services/rpc/call_gate.h"
#include "services/rpc/identity.h"
#include "services/rpc/revocation.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

// Leaves only TLS 1.3 to this process. Call first in main(), before there are threads (it sets an
// environment variable that gRPC reads once, at its first TLS use); Credentials::Load calls it too.
void RequireTls13();
// Sends what gRPC and Protobuf log to services/runtime/log.h at debug level: what matters of it
// reaches the daemon as a status, and is logged there. Call first in main().
void RouteGrpcLogs();
// Debian's abseil watches in which order gRPC takes its locks, and aborts the process at an order
// that could lead to a deadlock, whether it ever does or not. This ends that watch: a daemon must
// not end for it. Our own locks are others (services/runtime/mutex.h). Call first in main().
void TrustGrpcLockOrder();

// What `files` say, checked before they are used: all readable PEM, key belongs to certificate,
// certificate valid now and issued under `ca`, exactly one URI SAN of the forms of ParseSpiffeUri.
// InvalidArgument or the file's own error, naming the file and the remedy.
absl::StatusOr<Peer> ReadOwnCertificate(const TlsFiles& files);

// Our certificate and the authorities to trust. They are watched (every second): connections made
// after a change use the new ones, live streams go on. A directory must be replaced atomically: if
// certificate and key do not match, new connections fail until they do.
class Credentials {
 public:
  // Errors of ReadOwnCertificate and, if `files` name them, of Revocations::Open.
  static absl::StatusOr<std::shared_ptr<const Credentials>> Load(const TlsFiles& files);

  const TlsFiles& files() const { return files_; }
  // From the certificate as it was at Load.
  const PeerIdentity& self() const { return self_; }

  // Reads the revocation lists again if they have changed. Cheap if not; call it each second.
  void Refresh() const;
  // Set if one of the peer's certificates is revoked; a Judge.
  std::optional<Refusal> Revoked(const Peer& peer) const;
  // What is wrong with the revocation lists; OK also if there are none.
  absl::Status RevocationProblem(absl::Time now) const;

  // For agents and operators: accepts only a certificate that chains to `ca`, is not revoked, and
  // whose one URI is a policy server of self()'s trust domain; host names play no part. Refused in
  // the handshake, so
  // nothing is sent to another: an agent's certificate cannot play the server.
  std::shared_ptr<grpc::ChannelCredentials> ForClient() const { return client_; }
  // For the policy server: requires a client certificate that chains to `ca` and whose one URI is
  // an identity of self()'s trust domain. What that identity may do, and whether it is revoked, is
  // asked at each call (CallGate).
  std::shared_ptr<grpc::ServerCredentials> ForServer() const { return server_; }

 private:
  Credentials(const TlsFiles& files, PeerIdentity self, std::shared_ptr<Revocations> revocations);

  const TlsFiles files_;
  PeerIdentity self_;
  std::shared_ptr<Revocations> revocations_;  // null = nothing is revoked
  std::shared_ptr<grpc::ChannelCredentials> client_;
  std::shared_ptr<grpc::ServerCredentials> server_;
};

// Refuses a certificate that is not this daemon's.
using CheckIdentity = std::function<absl::Status(const PeerIdentity&)>;

// Credentials of this daemon. PermissionDenied, whatever else is wrong with them: `check` refused
// them, or others may use the key file. Unauthenticated: all other errors of Load; they may pass.
absl::StatusOr<std::shared_ptr<const Credentials>> LoadOwn(const TlsFiles& files,
                                                           const CheckIdentity& check);

// For --check-config, which refuses what the daemon would end for: PermissionDenied as LoadOwn. OK
// otherwise; `warning` says then what the daemon would wait for, and is empty if it is nothing.
absl::Status CheckOwn(const TlsFiles& files, const CheckIdentity& check, std::string* warning);

// An agent's credentials, which may not be usable yet: a board without a clock of its own starts
// before its certificate is valid, a disk is mounted late, a key is being replaced. Nothing of this
// ends a daemon; each attempt to connect asks again. Copies are the same source. Any thread.
class CredentialsSource {
 public:
  struct Usable {
    std::shared_ptr<grpc::ChannelCredentials> channel;
    std::shared_ptr<const Credentials> own;  // null: of a test, without checks of the peer
  };
  CredentialsSource() = default;
  // Usable from the start.
  CredentialsSource(std::shared_ptr<const Credentials> own);             // NOLINT: same source
  CredentialsSource(std::shared_ptr<grpc::ChannelCredentials> channel);  // NOLINT
  explicit CredentialsSource(TlsFiles files);

  // Once, before Get.
  void Require(CheckIdentity check);
  // PermissionDenied: `check` refused; no waiting mends that, only another file. All others: not
  // yet. Logs why when that changes and every 10 minutes, and when it is over.
  absl::StatusOr<Usable> Get() const;

 private:
  struct State;
  std::shared_ptr<State> state_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_CREDENTIALS_H_
