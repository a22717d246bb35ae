// Mutual TLS 1.3 from files, with identities checked while the connection is made.
#ifndef RIPS_SERVICES_RPC_CREDENTIALS_H_
#define RIPS_SERVICES_RPC_CREDENTIALS_H_

#include <memory>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "grpcpp/security/credentials.h"
#include "grpcpp/security/server_credentials.h"
#include "services/rpc/identity.h"
#include "services/runtime/config_sections.h"

namespace rips::rpc {

// Leaves only TLS 1.3 to this process. Call first in main(), before there are threads (it sets an
// environment variable that gRPC reads once, at its first TLS use); Credentials::Load calls it too.
void RequireTls13();

// What `files` say, checked before they are used: all readable PEM, key belongs to certificate,
// certificate valid now and issued under `ca`, exactly one URI SAN of the forms of ParseSpiffeUri.
struct OwnCertificate {
  PeerIdentity identity;
  absl::Time not_after;
};
// InvalidArgument or the file's own error, naming the file and the remedy.
absl::StatusOr<OwnCertificate> ReadOwnCertificate(const TlsFiles& files);

// One's own certificate and whom to trust. The files are watched (every second): connections made
// after a change use the new ones, live streams go on. A directory must be replaced atomically: if
// certificate and key do not match, new connections fail until they do.
class Credentials {
 public:
  // Errors of ReadOwnCertificate.
  static absl::StatusOr<std::shared_ptr<const Credentials>> Load(const TlsFiles& files);

  // From the certificate as it was at Load.
  const PeerIdentity& self() const { return self_; }
  // Reads the certificate file again, so that a renewed one is seen.
  absl::StatusOr<OwnCertificate> Current() const { return ReadOwnCertificate(files_); }

  // For agents and operators: accepts only a certificate that chains to `ca` and whose one URI is
  // a policy server of self()'s trust domain; host names play no part. Refused in the handshake, so
  // nothing is sent to another: an agent's certificate cannot play the server.
  std::shared_ptr<grpc::ChannelCredentials> ForClient() const;
  // For the policy server: requires a client certificate that chains to `ca` and whose one URI is
  // an identity of self()'s trust domain. What that identity may do is the service's to say.
  std::shared_ptr<grpc::ServerCredentials> ForServer() const;

 private:
  struct Parts;
  Credentials(TlsFiles files, PeerIdentity self);

  TlsFiles files_;
  PeerIdentity self_;
  std::shared_ptr<Parts> parts_;
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_CREDENTIALS_H_
