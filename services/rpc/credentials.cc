#include "services/rpc/credentials.h"

#include <cstdlib>
#include <functional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "grpcpp/security/tls_certificate_provider.h"
#include "grpcpp/security/tls_certificate_verifier.h"
#include "grpcpp/security/tls_credentials_options.h"
#include "services/base/status_macros.h"
#include "services/rpc/certificate.h"
#include "services/runtime/atomic_file.h"

namespace rips::rpc {
namespace {

namespace tls = grpc::experimental;

constexpr size_t kPemBytesMax = 1 << 20;
constexpr unsigned kRefreshSeconds = 1;

enum class Accept { kPolicyServer, kAnyRole };

// Judges the peer's leaf after its chain was verified, still inside the handshake.
class IdentityVerifier final : public tls::ExternalCertificateVerifier {
 public:
  IdentityVerifier(std::string trust_domain, Accept accept)
      : trust_domain_(std::move(trust_domain)), accept_(accept) {}

  bool Verify(tls::TlsCustomVerificationCheckRequest* request,
              std::function<void(grpc::Status)> /*callback*/, grpc::Status* sync_status) override {
    const grpc::string_ref pem = request->peer_cert();
    const absl::Status status = Judge(ReadLeaf(absl::string_view(pem.data(), pem.size())));
    *sync_status = status.ok() ? grpc::Status::OK
                               : grpc::Status(grpc::StatusCode::UNAUTHENTICATED,
                                              std::string(status.message()));
    return true;  // answered at once
  }
  void Cancel(tls::TlsCustomVerificationCheckRequest*) override {}

 private:
  absl::Status Judge(const absl::StatusOr<Leaf>& leaf) const {
    if (!leaf.ok()) return leaf.status();
    if (leaf->identity.trust_domain != trust_domain_) {
      return absl::UnauthenticatedError(absl::StrCat(
          "peer `", ToString(leaf->identity), "` is not of trust domain `", trust_domain_, "`"));
    }
    if (accept_ == Accept::kPolicyServer && leaf->identity.role != Role::kPolicyServer) {
      return absl::UnauthenticatedError(
          absl::StrCat("peer `", ToString(leaf->identity), "` is not a policy server"));
    }
    return absl::OkStatus();
  }

  const std::string trust_domain_;
  const Accept accept_;
};

}  // namespace

struct Credentials::Parts {
  std::shared_ptr<grpc::ChannelCredentials> client;
  std::shared_ptr<grpc::ServerCredentials> server;
};

void RequireTls13() {
  // A TLS 1.2 suite that needs a pre-shared key, which nobody has: TLS 1.2 cannot agree on any. The
  // suites of TLS 1.3 are configured apart from these and stay. gRPC 1.51 has no minimum version.
  setenv("GRPC_SSL_CIPHER_SUITES", "PSK-AES128-GCM-SHA256", 1);
}

absl::StatusOr<OwnCertificate> ReadOwnCertificate(const TlsFiles& files) {
  RIPS_ASSIGN_OR_RETURN(const std::string ca, ReadFile(files.ca, kPemBytesMax));
  RIPS_ASSIGN_OR_RETURN(const std::string cert, ReadFile(files.cert, kPemBytesMax));
  RIPS_ASSIGN_OR_RETURN(const std::string key, ReadFile(files.key, kPemBytesMax));
  const absl::StatusOr<Leaf> leaf = ReadLeaf(cert);
  absl::Status status = leaf.status();
  if (status.ok()) status = CheckChain(ca, cert, key);
  if (!status.ok()) {
    return absl::InvalidArgumentError(absl::StrCat("certificate `", files.cert, "` (ca `", files.ca,
                                                   "`, key `", files.key,
                                                   "`) cannot be used: ", status.message()));
  }
  return OwnCertificate{.identity = leaf->identity, .not_after = leaf->not_after};
}

Credentials::Credentials(TlsFiles files, PeerIdentity self)
    : files_(std::move(files)), self_(std::move(self)), parts_(std::make_shared<Parts>()) {
  const auto provider = std::make_shared<tls::FileWatcherCertificateProvider>(
      files_.key, files_.cert, files_.ca, kRefreshSeconds);
  const auto configure = [&](auto& options, Accept accept) {
    options.watch_root_certs();
    options.watch_identity_key_cert_pairs();
    options.set_certificate_verifier(
        tls::ExternalCertificateVerifier::Create<IdentityVerifier>(self_.trust_domain, accept));
  };
  tls::TlsChannelCredentialsOptions client;
  client.set_certificate_provider(provider);
  client.set_verify_server_certs(true);
  client.set_check_call_host(false);
  configure(client, Accept::kPolicyServer);
  parts_->client = tls::TlsCredentials(client);

  tls::TlsServerCredentialsOptions server(provider);
  server.set_cert_request_type(GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  configure(server, Accept::kAnyRole);
  parts_->server = tls::TlsServerCredentials(server);
}

absl::StatusOr<std::shared_ptr<const Credentials>> Credentials::Load(const TlsFiles& files) {
  RequireTls13();
  RIPS_ASSIGN_OR_RETURN(const OwnCertificate own, ReadOwnCertificate(files));
  return std::shared_ptr<const Credentials>(new Credentials(files, own.identity));
}

std::shared_ptr<grpc::ChannelCredentials> Credentials::ForClient() const { return parts_->client; }

std::shared_ptr<grpc::ServerCredentials> Credentials::ForServer() const { return parts_->server; }

}  // namespace rips::rpc
