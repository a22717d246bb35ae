// Which certificates their authorities have taken back: certificate revocation lists (RFC 5280 §5)
// from a file or a directory, read again when they change.
//
// | what is found at `tls.crl`                          | effect                                  |
// |-----------------------------------------------------|-----------------------------------------|
// | lists signed by authorities under `ca`              | in force                                |
// | at start: nothing readable                          | the credentials cannot be used yet      |
// | later: unreadable, malformed, older, or an issuer   | the lists in force stay; `problem()`    |
// |   whose list was there is gone                      |                                         |
// | a list past its nextUpdate                          | stays in force; `problem()`. Who is not |
// |                                                     | on it is still accepted: a fleet is not |
// |                                                     | deafened because a job did not run      |
// | no list of some authority                           | nothing of that authority is revoked    |
#ifndef RIPS_SERVICES_RPC_REVOCATION_H_
#define RIPS_SERVICES_RPC_REVOCATION_H_

#include <map>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "services/rpc/certificate.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/mutex.h"

namespace rips::rpc {

// The newest list of each issuer. Immutable.
class RevocationLists {
 public:
  // `pems`: lists, and certificates of authorities that neither of the others holds. `ca` and
  // `authorities` as in CheckChain. InvalidArgument if there is no list, one cannot be decoded, or
  // its signer is not an authority under `ca`.
  static absl::StatusOr<RevocationLists> Parse(const std::vector<std::string>& pems,
                                               absl::string_view ca, absl::string_view authorities);

  bool Revokes(const CertificateId& certificate) const;
  // OK if this may take the place of `old`: it has a list of each issuer, none of them older.
  absl::Status Follows(const RevocationLists& old) const;
  // The first time at which one of the lists is out of date; InfiniteFuture if none says.
  absl::Time next_update() const { return next_update_; }
  size_t size() const;

 private:
  struct List {
    absl::Time this_update;
    absl::Time next_update = absl::InfiniteFuture();
    std::set<std::string> serials;
  };
  std::map<std::string, List> by_issuer_;  // distinguished name, DER
  absl::Time next_update_ = absl::InfiniteFuture();
};

// The lists in force, and the file or directory they come from. Any thread.
class Revocations {
 public:
  // `files.crl` is not empty. Errors of reading and of RevocationLists::Parse.
  static absl::StatusOr<std::shared_ptr<Revocations>> Open(const TlsFiles& files);

  // Reads again if the file, or a file of the directory, is not what it was. Logs what changed.
  void Refresh() ABSL_LOCKS_EXCLUDED(mu_);
  // True if one of `chain` is revoked.
  bool Revoke(const std::vector<CertificateId>& chain) const ABSL_LOCKS_EXCLUDED(mu_);
  // Why the lists in force are not what they should be; OK if they are.
  absl::Status problem(absl::Time now) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  explicit Revocations(TlsFiles files) : files_(std::move(files)) {}
  absl::StatusOr<RevocationLists> Read() const;

  const TlsFiles files_;
  mutable Mutex mu_;
  std::shared_ptr<const RevocationLists> lists_ ABSL_GUARDED_BY(mu_);
  std::string stamp_ ABSL_GUARDED_BY(mu_);
  absl::Status unread_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::rpc

#endif  // RIPS_SERVICES_RPC_REVOCATION_H_
