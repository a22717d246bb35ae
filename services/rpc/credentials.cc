#include "services/rpc/credentials.h"

#include <cstdlib>
#include <functional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/synchronization/mutex.h"
#include "google/protobuf/stubs/logging.h"
#include "grpc/support/log.h"
#include "grpcpp/security/tls_certificate_provider.h"
#include "grpcpp/security/tls_certificate_verifier.h"
#include "grpcpp/security/tls_credentials_options.h"
#include "services/base/status_macros.h"
#include "services/rpc/certificate.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/await.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/key_mode.h"
#include "services/runtime/log.h"
#include "services/runtime/real_clock.h"

namespace rips::rpc {
namespace {

namespace tls = grpc::experimental;

constexpr size_t kPemBytesMax = 1 << 20;
constexpr unsigned kRefreshSeconds = 1;

constexpr char kRevoked[] = "the certificate is revoked";

enum class Accept { kPolicyServer, kAnyRole };

// Judges the peer's leaf after its chain was verified, still inside the handshake.
class IdentityVerifier final : public tls::ExternalCertificateVerifier {
 public:
  IdentityVerifier(std::string trust_domain, Accept accept, std::shared_ptr<Revocations> lists)
      : trust_domain_(std::move(trust_domain)), accept_(accept), lists_(std::move(lists)) {}

  bool Verify(tls::TlsCustomVerificationCheckRequest* request,
              std::function<void(grpc::Status)> /*callback*/, grpc::Status* sync_status) override {
    const grpc::string_ref pem = request->peer_cert();
    absl::Status status = Judge(ReadLeaf(absl::string_view(pem.data(), pem.size())));
    if (status.ok() && lists_ != nullptr) {
      std::vector<CertificateId> chain = ReadChain(absl::string_view(pem.data(), pem.size()));
      const grpc::string_ref more = request->peer_cert_full_chain();
      for (CertificateId& each : ReadChain(absl::string_view(more.data(), more.size()))) {
        chain.push_back(std::move(each));
      }
      if (lists_->Revoke(chain)) status = absl::UnauthenticatedError(kRevoked);
    }
    *sync_status = status.ok() ? grpc::Status::OK
                               : grpc::Status(grpc::StatusCode::UNAUTHENTICATED,
                                              std::string(status.message()));
    return true;  // answered at once
  }
  void Cancel(tls::TlsCustomVerificationCheckRequest*) override {}

 private:
  absl::Status Judge(const absl::StatusOr<Peer>& leaf) const {
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
  const std::shared_ptr<Revocations> lists_;  // null = none
};

}  // namespace

void RequireTls13() {
  // A TLS 1.2 suite that needs a pre-shared key; no peer has one: TLS 1.2 cannot agree on any. The
  // suites of TLS 1.3 are configured apart from these and stay. gRPC 1.51 has no minimum version.
  setenv("GRPC_SSL_CIPHER_SUITES", "PSK-AES128-GCM-SHA256", 1);
}

void RouteGrpcLogs() {
  gpr_set_log_function([](gpr_log_func_args* args) {
    LogOfLibrary(LogLevel::kDebug, "grpc", args->message,
                 absl::StrCat(args->file, ":", args->line));
  });
  // It tells of each message with a text that is not UTF-8: peers would write into the log.
  google::protobuf::SetLogHandler(
      [](google::protobuf::LogLevel, const char* file, int line, const std::string& text) {
        LogOfLibrary(LogLevel::kDebug, "protobuf", text, absl::StrCat(file, ":", line));
      });
}

void TrustGrpcLockOrder() { absl::SetMutexDeadlockDetectionMode(absl::OnDeadlockCycle::kIgnore); }

absl::StatusOr<Peer> ReadOwnCertificate(const TlsFiles& files) {
  RIPS_ASSIGN_OR_RETURN(const std::string ca, ReadFile(files.ca, kPemBytesMax));
  RIPS_ASSIGN_OR_RETURN(const std::string cert, ReadFile(files.cert, kPemBytesMax));
  RIPS_ASSIGN_OR_RETURN(const std::string key, ReadFile(files.key, kPemBytesMax));
  absl::StatusOr<Peer> leaf = ReadLeaf(cert);
  absl::Status status = leaf.status();
  if (status.ok()) status = CheckChain(ca, cert, key);
  if (!status.ok()) {
    return absl::InvalidArgumentError(absl::StrCat("certificate `", files.cert, "` (ca `", files.ca,
                                                   "`, key `", files.key,
                                                   "`) cannot be used: ", status.message()));
  }
  return leaf;
}

Credentials::Credentials(const TlsFiles& files, PeerIdentity self,
                         std::shared_ptr<Revocations> revocations)
    : files_(files), self_(std::move(self)), revocations_(std::move(revocations)) {
  const auto provider = std::make_shared<tls::FileWatcherCertificateProvider>(
      files.key, files.cert, files.ca, kRefreshSeconds);
  const auto configure = [&](auto& options, Accept accept, std::shared_ptr<Revocations> lists) {
    options.watch_root_certs();
    options.watch_identity_key_cert_pairs();
    options.set_certificate_verifier(tls::ExternalCertificateVerifier::Create<IdentityVerifier>(
        self_.trust_domain, accept, std::move(lists)));
  };
  tls::TlsChannelCredentialsOptions client;
  client.set_certificate_provider(provider);
  client.set_verify_server_certs(true);
  client.set_check_call_host(false);
  configure(client, Accept::kPolicyServer, revocations_);
  client_ = tls::TlsCredentials(client);

  tls::TlsServerCredentialsOptions server(provider);
  server.set_cert_request_type(GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  // Who is revoked is refused at its calls, with a status that says so, and counted.
  configure(server, Accept::kAnyRole, nullptr);
  server_ = tls::TlsServerCredentials(server);
}

absl::StatusOr<std::shared_ptr<const Credentials>> Credentials::Load(const TlsFiles& files) {
  RequireTls13();
  RIPS_ASSIGN_OR_RETURN(const Peer own, ReadOwnCertificate(files));
  std::shared_ptr<Revocations> revocations;
  if (!files.crl.empty()) {
    RIPS_ASSIGN_OR_RETURN(revocations, Revocations::Open(files));
  }
  return std::shared_ptr<const Credentials>(
      new Credentials(files, own.identity, std::move(revocations)));
}

void Credentials::Refresh() const {
  if (revocations_ != nullptr) revocations_->Refresh();
}

std::optional<Refusal> Credentials::Revoked(const Peer& peer) const {
  if (revocations_ == nullptr || !revocations_->Revoke(peer.chain)) return std::nullopt;
  return Refusal{"revoked", absl::UnauthenticatedError(kRevoked)};
}

absl::Status Credentials::RevocationProblem(absl::Time now) const {
  return revocations_ == nullptr ? absl::OkStatus() : revocations_->problem(now);
}

namespace {

// LoadOwn; `warning` is set if something is to be said of what can be used.
absl::StatusOr<std::shared_ptr<const Credentials>> LoadOwn(const TlsFiles& files,
                                                           const CheckIdentity& check,
                                                           std::string* warning) {
  // Checked first: a certificate of another identity stays wrong, whatever the clock says.
  const absl::StatusOr<std::string> cert = ReadFile(files.cert, kPemBytesMax);
  const absl::StatusOr<Peer> leaf = cert.ok() ? ReadLeaf(*cert) : cert.status();
  if (leaf.ok() && check) {
    const absl::Status mine = check(leaf->identity);
    if (!mine.ok()) return absl::PermissionDeniedError(mine.message());
  }
  RIPS_RETURN_IF_ERROR(CheckKeyMode(files.key, warning));
  auto own = Credentials::Load(files);
  if (!own.ok()) return absl::UnauthenticatedError(own.status().message());
  if (check) {  // it may have been replaced in between
    const absl::Status mine = check((*own)->self());
    if (!mine.ok()) return absl::PermissionDeniedError(mine.message());
  }
  return own;
}

}  // namespace

absl::StatusOr<std::shared_ptr<const Credentials>> LoadOwn(const TlsFiles& files,
                                                           const CheckIdentity& check) {
  std::string warning;
  auto own = LoadOwn(files, check, &warning);
  if (own.ok() && !warning.empty()) LogWarning(warning);
  return own;
}

absl::Status CheckOwn(const TlsFiles& files, const CheckIdentity& check, std::string* warning) {
  warning->clear();
  const absl::Status own = LoadOwn(files, check, warning).status();
  if (absl::IsPermissionDenied(own)) return own;
  if (!own.ok()) *warning = absl::StrCat("no usable certificate: ", own.message());
  return absl::OkStatus();
}

// --- CredentialsSource

struct CredentialsSource::State {
  std::optional<TlsFiles> files;  // none: given
  CheckIdentity check;
  Mutex mu;
  std::optional<Usable> usable ABSL_GUARDED_BY(mu);
  RepeatFilter filter ABSL_GUARDED_BY(mu);

  void Await(const absl::Status& why) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) {
    if (!filter.Pass(why.message(), BoottimeNow())) return;
    LogError("waiting for a usable certificate", {{"reason", why.message()}});
  }

  // Of files that were replaced since: they must be ours still. Not PermissionDenied, so that the
  // daemon goes on: as when its server is away. What cannot be read is logged; connections are made
  // with what was read before for as long as that is good.
  absl::Status CheckPresent() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu) {
    if (!files.has_value()) return absl::OkStatus();
    const absl::StatusOr<Peer> present = ReadOwnCertificate(*files);
    if (!present.ok()) {
      Await(present.status());
      return absl::OkStatus();
    }
    const absl::Status ours = check ? check(present->identity) : absl::OkStatus();
    if (ours.ok()) return ours;
    Await(ours);
    return absl::UnauthenticatedError(ours.message());
  }
};

CredentialsSource::CredentialsSource(std::shared_ptr<const Credentials> own)
    : state_(std::make_shared<State>()) {
  MutexLock lock(&state_->mu);
  state_->usable = Usable{.channel = own->ForClient(), .own = std::move(own)};
}

CredentialsSource::CredentialsSource(std::shared_ptr<grpc::ChannelCredentials> channel)
    : state_(std::make_shared<State>()) {
  MutexLock lock(&state_->mu);
  state_->usable = Usable{.channel = std::move(channel), .own = nullptr};
}

CredentialsSource::CredentialsSource(TlsFiles files) : state_(std::make_shared<State>()) {
  state_->files = std::move(files);
}

void CredentialsSource::Require(CheckIdentity check) { state_->check = std::move(check); }

absl::StatusOr<CredentialsSource::Usable> CredentialsSource::Get() const {
  MutexLock lock(&state_->mu);
  if (state_->usable.has_value()) {
    if (state_->check && state_->usable->own != nullptr) {
      RIPS_RETURN_IF_ERROR(state_->check(state_->usable->own->self()));
    }
    RIPS_RETURN_IF_ERROR(state_->CheckPresent());
    return *state_->usable;
  }
  auto own = LoadOwn(*state_->files, state_->check);
  if (!own.ok()) {
    state_->Await(own.status());
    return own.status();
  }
  if (state_->filter.said()) LogInfo("certificate usable", {{"file", state_->files->cert}});
  state_->usable = Usable{.channel = (*own)->ForClient(), .own = *own};
  return *state_->usable;
}

}  // namespace rips::rpc
