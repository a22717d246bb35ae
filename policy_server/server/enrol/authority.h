// What signs certificates: the issuing key of the server's configuration, or its program.
#ifndef RIPS_POLICY_SERVER_SERVER_ENROL_AUTHORITY_H_
#define RIPS_POLICY_SERVER_SERVER_ENROL_AUTHORITY_H_

#include <optional>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "policy_server/server/enrol/external_ca.h"
#include "services/pki/certificate_check.h"
#include "services/pki/issuer.h"

namespace rips::enrol {

struct IssuingFiles {
  // PEM: the issuing certificate and what is between it and a root of `ca`; its key; tls.ca. Only
  // the last is read if there is an ExternalCa.
  std::string cert;
  std::string key;
  std::string ca;
};

// What is wrong with them, a key that other users may read included; OK = certificates can be
// signed, if the issuer is valid now.
absl::Status CheckIssuingFiles(const IssuingFiles& files);

struct SigningOrder {
  const pki::CertificateRequest* request = nullptr;  // not owned
  // What `request` was read from.
  std::string request_pem;
  rpc::PeerIdentity identity;
  CertificateHolder holder;
  absl::Duration life;
};

// Any thread.
class Authority {
 public:
  // Reads the files anew, so that new ones need no restart. `external` is not owned and outlives
  // the result; null: the key signs. FailedPrecondition, naming the file.
  static absl::StatusOr<Authority> Read(const IssuingFiles& files, const ExternalCa* external);

  // Blocks on the program, if there is one. Errors of Issuer and of ExternalCa.
  absl::StatusOr<pki::Issued> Sign(const SigningOrder& order, absl::Time now) const;
  bool is_external() const { return external_ != nullptr; }
  // The content of `ca`.
  const std::string& ca_pem() const { return ca_pem_; }

 private:
  Authority(std::optional<pki::Issuer> issuer, const ExternalCa* external, std::string ca_pem)
      : issuer_(std::move(issuer)), external_(external), ca_pem_(std::move(ca_pem)) {}

  std::optional<pki::Issuer> issuer_;
  const ExternalCa* external_;
  std::string ca_pem_;
};

}  // namespace rips::enrol

#endif  // RIPS_POLICY_SERVER_SERVER_ENROL_AUTHORITY_H_
