// Who gets a certificate, and of what: tokens that an admin makes, certificates fetched with them,
// and renewals. Signs with the issuing key of the server's configuration, or has a program sign.
//
// | asks                  | gets a certificate if                                               |
// |-----------------------|---------------------------------------------------------------------|
// | an admin, for a token | the inventory lists an agent of the robot on that host              |
// | the holder of a token | it is known, neither revoked nor expired, for that role, not used   |
// |                       | by another key, the inventory lists the agent still, and neither    |
// |                       | the agent nor who made the token is banned                          |
// | an agent, to renew    | the inventory lists it still, and 10 s have passed                  |
//
// The same key with the same token gets the same certificate again: an answer can be lost.
// What a certificate says comes from the token or from the one that is renewed, never from who
// asks. Nothing is given out before it is recorded. While a certificate is being signed, a second
// one for the same agent with the same token, or for its renewal, is refused: of two that show one
// token at once, one gets a certificate. A token whose call failed can be used again.
// Any thread; all but the constructor block on the disk, and CreateToken, Enrol and Renew on the
// program: with one, call them on threads().
#ifndef RIPS_POLICY_SERVER_SERVER_ENROL_ENROLMENT_H_
#define RIPS_POLICY_SERVER_SERVER_ENROL_ENROLMENT_H_

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/policy/engine/state/effect.h"
#include "policy_server/server/enrol/authority.h"
#include "policy_server/server/enrol/ongoing_calls.h"
#include "policy_server/server/enrol/signing_threads.h"
#include "policy_server/server/store/enrolment_store.h"
#include "services/base/clock.h"
#include "services/rpc/certificate.h"
#include "services/runtime/mutex.h"

namespace rips::enrol {

inline constexpr absl::Duration kTokenLifeDefault = absl::Hours(1);
inline constexpr absl::Duration kTokenLifeMin = absl::Minutes(1);
inline constexpr absl::Duration kTokenLifeMax = absl::Hours(24);
// Between two certificates for the same agent: each costs a signature and a write.
inline constexpr absl::Duration kBetweenRenewals = absl::Seconds(10);
inline constexpr absl::Duration kBetweenFetches = absl::Seconds(1);
// Certificates of one agent that are good: more are an alert. A change of the root takes three.
inline constexpr size_t kGoodWithoutAlert = 4;

struct EnrolmentOptions {
  IssuingFiles files;
  // Not owned, outlives the enrolment; null: the key in `files` signs.
  const ExternalCa* external_ca = nullptr;
  std::string trust_domain;
  // Of a certificate that is issued.
  absl::Duration life = absl::Hours(24 * 30);
};

struct TokenOrder {
  std::string robot;
  std::string host;
  // `sensor`, `actuator`; empty = what the inventory lists on that host.
  std::vector<std::string> roles;
  // Zero = kTokenLifeDefault.
  absl::Duration valid;
  // Of the key that is the token's secret.
  std::string request_pem;
  // As rpc::Describe gives it.
  std::string by;
};

struct Fetched {
  // What was recorded; of a token nothing.
  store::IssuedRecord record;
  std::string certificates_pem;
  // The present content of `ca`.
  std::string authorities_pem;
};

struct NewToken {
  store::TokenRecord record;
  Fetched fetched;
};

// None may block; all must be set.
struct EnrolmentPorts {
  // Whether that certificate is banned; without a serial, whether its identity is.
  std::function<bool(const rpc::PeerIdentity&, const std::string& serial)> is_banned;
  // To be raised as an alert of the robot.
  std::function<void(const std::string& robot, engine::Severity, const std::string& text)> tell;
  // An agent's certificate, before the agent shows it.
  std::function<void(const rpc::Peer& agent)> issued;
};

class Enrolment {
 public:
  // `store` and `clock` are not owned and outlive this.
  Enrolment(EnrolmentOptions options, store::EnrolmentStore* store, const Clock* clock,
            EnrolmentPorts ports)
      : options_(std::move(options)),
        store_(store),
        clock_(clock),
        ports_(std::move(ports)),
        threads_(options_.external_ca == nullptr ? 1 : kExternalCaRunsMax) {}

  // Who is listed from now on; before, no agent is.
  void SetInventory(const bundle::Inventory& inventory) ABSL_LOCKS_EXCLUDED(mu_);

  // InvalidArgument for a role or a life that there is not; NotFound if the inventory does not list
  // such an agent; errors of CertificateRequest, Issuer, ExternalCa and the store.
  absl::StatusOr<NewToken> CreateToken(const TokenOrder& order) ABSL_LOCKS_EXCLUDED(mu_);
  // What it has fetched stays good. NotFound.
  absl::Status RevokeToken(const std::string& id);
  // PermissionDenied, FailedPrecondition: see the table; ResourceExhausted: too soon, or too many
  // that are good; Unavailable: one is being signed, or the program says to try again later.
  absl::StatusOr<Fetched> Enrol(const rpc::PeerIdentity& token, const std::string& role,
                                const std::string& request_pem) ABSL_LOCKS_EXCLUDED(mu_);
  // As Enrol.
  absl::StatusOr<Fetched> Renew(const rpc::PeerIdentity& agent, const std::string& request_pem)
      ABSL_LOCKS_EXCLUDED(mu_);

  store::EnrolmentStore& store() { return *store_; }
  // Where calls run that ask for signatures.
  SigningThreads& threads() { return threads_; }

 private:
  absl::Time Now() const { return absl::FromUnixNanos(clock_->Now().unix_ns); }
  // For an agent: ResourceExhausted if it has too many, PermissionDenied if it is banned by
  // the end, FailedPrecondition, with an alert, if the serial number is not new.
  absl::StatusOr<pki::Issued> SignNew(const Authority& authority, const SigningOrder& order);
  absl::StatusOr<Fetched> Issue(const rpc::PeerIdentity& identity, const std::string& token,
                                const std::string& request_pem);
  // What this token gave this key before; nothing if it gave none yet. FailedPrecondition, with an
  // alert, if it was another key.
  absl::StatusOr<std::optional<Fetched>> GivenBefore(const rpc::PeerIdentity& identity,
                                                     const std::string& token,
                                                     const std::string& key_hash,
                                                     const std::string& ca_pem);
  absl::Status CheckNotBanned(const rpc::PeerIdentity& agent, const std::string& made_by) const;
  // Alerts of what was issued.
  void Report(const rpc::PeerIdentity& identity, const store::IssuedRecord& issued);
  bool IsListed(const std::string& robot, const std::string& host, const std::string& role)
      ABSL_LOCKS_EXCLUDED(mu_);
  // ResourceExhausted if `who` was here less than `between` ago.
  absl::Status NotTooSoon(const std::string& who, absl::Duration between) ABSL_LOCKS_EXCLUDED(mu_);

  const EnrolmentOptions options_;
  store::EnrolmentStore* const store_;
  const Clock* const clock_;
  const EnrolmentPorts ports_;
  Mutex mu_;
  // `ROBOT/HOST/ROLE`.
  std::set<std::string> listed_ ABSL_GUARDED_BY(mu_);
  // When each was here last, by CLOCK_BOOTTIME.
  std::map<std::string, int64_t> last_ns_ ABSL_GUARDED_BY(mu_);
  OngoingCalls ongoing_;
  // Last: what runs on them uses the others.
  SigningThreads threads_;
};

}  // namespace rips::enrol

#endif  // RIPS_POLICY_SERVER_SERVER_ENROL_ENROLMENT_H_
