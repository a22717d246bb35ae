#include "services/enrol/fetch.h"

#include <stdlib.h>

#include <filesystem>
#include <memory>
#include <system_error>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "rips/v1/enrolment.grpc.pb.h"
#include "services/base/status_macros.h"
#include "services/pki/key_request.h"
#include "services/rpc/bidi_client.h"
#include "services/rpc/credentials.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/atomic_file.h"

namespace rips::enrol {
namespace {

// The token's own certificate and key, for as long as they are used; readable for us alone.
class TokenFiles {
 public:
  static absl::StatusOr<std::unique_ptr<TokenFiles>> Make(const v1::EnrolmentToken& token,
                                                          const KeyFolder& folder) {
    std::string path = absl::StrCat(folder.path(), "/", kTokenFolder, "XXXXXX");
    if (mkdtemp(path.data()) == nullptr) {
      return absl::ErrnoToStatus(errno, absl::StrCat("cannot write in `", folder.path(), "`"));
    }
    std::unique_ptr<TokenFiles> files(new TokenFiles(std::move(path)));
    const TlsFiles tls = files->tls();
    RIPS_RETURN_IF_ERROR(WriteFileAtomically(tls.ca, token.authorities_pem()));
    RIPS_RETURN_IF_ERROR(WriteFileAtomically(tls.cert, token.certificates_pem()));
    RIPS_RETURN_IF_ERROR(WriteFileAtomically(tls.key, token.key_pem()));
    return files;
  }
  ~TokenFiles() {
    std::error_code error;
    std::filesystem::remove_all(path_, error);
  }
  TokenFiles(const TokenFiles&) = delete;
  TokenFiles& operator=(const TokenFiles&) = delete;

  TlsFiles tls() const {
    return {.ca = path_ + "/ca.pem", .cert = path_ + "/cert.pem", .key = path_ + "/key.pem"};
  }

 private:
  explicit TokenFiles(std::string path) : path_(std::move(path)) {}

  const std::string path_;
};

// OK if what came is for our key, under the authorities that came with it, and says what it shall.
absl::StatusOr<rpc::Peer> Judge(const v1::IssuedCertificate& issued, const std::string& key_pem,
                                const std::string& wanted_uri) {
  const absl::Status chained =
      rpc::CheckChain(issued.authorities_pem(), issued.certificates_pem(), key_pem);
  const absl::StatusOr<rpc::Peer> peer = rpc::ReadLeaf(issued.certificates_pem());
  if (!chained.ok() || !peer.ok()) {
    return absl::DataLossError(absl::StrCat("the server sent a certificate that cannot be used: ",
                                            (chained.ok() ? peer.status() : chained).message()));
  }
  const std::string uri = rpc::ToString(peer->identity);
  if (uri == wanted_uri) return peer;
  return absl::DataLossError(
      absl::StrCat("the server sent a certificate of ", uri, ", not of ", wanted_uri));
}

template <typename Request>
using Method = grpc::Status (rips::v1::EnrolmentService::StubInterface::*)(grpc::ClientContext*,
                                                                           const Request&,
                                                                           v1::IssuedCertificate*);

template <typename Request>
absl::StatusOr<v1::IssuedCertificate> Call(const std::string& server,
                                           const rpc::Credentials& credentials,
                                           Method<Request> method, const Request& request,
                                           absl::Duration timeout) {
  const auto stub =
      rips::v1::EnrolmentService::NewStub(rpc::MakeChannel(server, credentials.ForClient()));
  grpc::ClientContext context;
  context.set_wait_for_ready(false);
  context.set_deadline(absl::ToChronoTime(absl::Now() + timeout));
  v1::IssuedCertificate issued;
  rips::v1::EnrolmentService::StubInterface& calls = *stub;
  const grpc::Status status = (calls.*method)(&context, request, &issued);
  if (status.ok()) return issued;
  const absl::Status failed = rpc::FromGrpc(status);
  // A server that is there says itself what to do.
  const bool unreachable = (absl::IsUnavailable(failed) || absl::IsDeadlineExceeded(failed)) &&
                           !absl::StrContains(failed.message(), "try again later");
  return absl::Status(
      failed.code(),
      absl::StrCat(server, ": ", failed.message(),
                   unreachable ? "; check that the policy server runs, that this host reaches it, "
                                 "and that it is of this fleet"
                               : ""));
}

std::string UtcText(absl::Time time) {
  return absl::FormatTime("%Y-%m-%d %H:%M:%S UTC", time, absl::UTCTimeZone());
}

// Of a token whose certificate cannot be used.
absl::Status WhyNotNow(const v1::EnrolmentToken& token, const absl::Status& status) {
  const absl::Time now = absl::Now();
  const auto peer = rpc::ReadLeaf(token.certificates_pem());
  if (peer.ok() && now > peer->not_after) {
    return absl::FailedPreconditionError(absl::StrCat(
        "the token has expired, at ", UtcText(peer->not_after), ", and this host's clock says ",
        UtcText(now), "; ask an admin for a new one, or set the clock"));
  }
  if (peer.ok() && now < peer->not_before) {
    return absl::FailedPreconditionError(
        absl::StrCat("this host's clock says ", UtcText(now), ", and the token is good from ",
                     UtcText(peer->not_before), "; set the clock"));
  }
  return absl::FailedPreconditionError(
      absl::StrCat("the token is damaged, or of another fleet: ", status.message()));
}

}  // namespace

absl::StatusOr<rpc::Peer> FetchFirst(const v1::EnrolmentToken& token, const std::string& role,
                                     const KeyFolder& folder, absl::Duration timeout,
                                     bool replace_identity) {
  RIPS_ASSIGN_OR_RETURN(const UniqueFd lock, folder.Lock());
  RIPS_ASSIGN_OR_RETURN(const auto files, TokenFiles::Make(token, folder));
  absl::StatusOr<std::shared_ptr<const rpc::Credentials>> credentials =
      rpc::Credentials::Load(files->tls());
  if (!credentials.ok()) return WhyNotNow(token, credentials.status());
  const rpc::PeerIdentity& own = (*credentials)->self();
  if (own.role != rpc::Role::kEnrolment) {
    return absl::InvalidArgumentError("the token's certificate is no token's");
  }
  const rpc::PeerIdentity wanted{
      .role = role == "sensor" ? rpc::Role::kSensor : rpc::Role::kActuator,
      .trust_domain = own.trust_domain,
      .robot = token.robot(),
      .host = token.host()};
  const std::string holder = folder.Holder();
  if (!replace_identity && !holder.empty() && holder != rpc::ToString(wanted)) {
    return absl::FailedPreconditionError(absl::StrCat(
        "`", folder.path(), "` holds the certificate of ", holder, ", and the token is for ",
        rpc::ToString(wanted), "; if this host changes its identity, use --replace-identity"));
  }
  RIPS_ASSIGN_OR_RETURN(const std::string key, folder.PendingKey());
  v1::EnrolRequest request;
  request.set_role(role);
  RIPS_ASSIGN_OR_RETURN(*request.mutable_request_pem(), pki::RequestFor(key));
  RIPS_ASSIGN_OR_RETURN(const v1::IssuedCertificate issued,
                        Call(token.server(), **credentials,
                             &rips::v1::EnrolmentService::StubInterface::Enrol, request, timeout));
  RIPS_ASSIGN_OR_RETURN(const rpc::Peer peer, Judge(issued, key, rpc::ToString(wanted)));
  RIPS_RETURN_IF_ERROR(folder.Install({.ca_pem = issued.authorities_pem(),
                                       .certificates_pem = issued.certificates_pem(),
                                       .key_pem = key,
                                       .server = token.server()}));
  return peer;
}

absl::StatusOr<rpc::Peer> Renew(const KeyFolder& folder, const std::string& server,
                                absl::Duration timeout) {
  RIPS_ASSIGN_OR_RETURN(const UniqueFd lock, folder.Lock());
  RIPS_ASSIGN_OR_RETURN(const auto credentials, rpc::Credentials::Load(folder.tls()));
  RIPS_ASSIGN_OR_RETURN(const std::string key, folder.PendingKey());
  v1::RenewRequest request;
  RIPS_ASSIGN_OR_RETURN(*request.mutable_request_pem(), pki::RequestFor(key));
  RIPS_ASSIGN_OR_RETURN(const v1::IssuedCertificate issued,
                        Call(server, *credentials,
                             &rips::v1::EnrolmentService::StubInterface::Renew, request, timeout));
  RIPS_ASSIGN_OR_RETURN(const rpc::Peer peer,
                        Judge(issued, key, rpc::ToString(credentials->self())));
  RIPS_RETURN_IF_ERROR(folder.Install({.ca_pem = issued.authorities_pem(),
                                       .certificates_pem = issued.certificates_pem(),
                                       .key_pem = key,
                                       .server = server}));
  return peer;
}

absl::StatusOr<rpc::Peer> Present(const KeyFolder& folder) {
  return rpc::ReadOwnCertificate(folder.tls());
}

bool IsDue(const rpc::Peer& certificate, absl::Time now) {
  return now >=
         certificate.not_before + (certificate.not_after - certificate.not_before) * kDueAfter;
}

}  // namespace rips::enrol
