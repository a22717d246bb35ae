#include "policy_server/server/enrol/enrolment.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::enrol {
namespace {

constexpr size_t kTokenIdDigits = 16;
// Remembered; of more, the next may come sooner.
constexpr size_t kLastMax = 20'000;
constexpr const char* kRoles[] = {"sensor", "actuator"};

bool IsRole(const std::string& role) {
  return std::find(std::begin(kRoles), std::end(kRoles), role) != std::end(kRoles);
}

std::string KeyOf(const std::string& robot, const std::string& host, const std::string& role) {
  return absl::StrCat(robot, "/", host, "/", role);
}

std::string UtcText(absl::Time time) {
  return absl::FormatTime("%Y-%m-%d %H:%M UTC", time, absl::UTCTimeZone());
}

absl::Status NotListed(const std::string& robot, const std::string& host, const std::string& role) {
  return absl::PermissionDeniedError(absl::StrCat("the inventory does not list the ", role, " of ",
                                                  robot, " on host ", host,
                                                  " (any more); see robots.yaml"));
}

// ResourceExhausted if no more may be good; else the serials of all that are listed.
absl::StatusOr<std::set<std::string>> SerialsOf(const std::string& uri,
                                                store::EnrolmentStore& store, absl::Time now) {
  RIPS_ASSIGN_OR_RETURN(const std::vector<store::IssuedRecord> all, store.ListIssued(uri));
  std::set<std::string> serials;
  int64_t good = 0;
  for (const store::IssuedRecord& each : all) {
    serials.insert(each.serial);
    good += each.not_after_unix_ns > absl::ToUnixNanos(now) ? 1 : 0;
  }
  if (good >= store::kGoodPerIdentityMax) return store::TooManyGood(uri, good);
  return serials;
}

// What a program does wrong is an alert of the robot.
absl::StatusOr<pki::Issued> Sign(const Authority& authority, const SigningOrder& order,
                                 absl::Time now, const EnrolmentPorts& ports) {
  absl::StatusOr<pki::Issued> issued = authority.Sign(order, now);
  // What is tried again later is none.
  if (issued.ok() || !authority.is_external() || absl::IsUnavailable(issued.status())) {
    return issued;
  }
  ports.tell(order.holder.robot,
             absl::IsPermissionDenied(issued.status()) ? engine::Severity::kMedium
                                                       : engine::Severity::kHigh,
             absl::StrCat("no certificate for ", rpc::ToString(order.identity), ": ",
                          issued.status().message()));
  return issued;
}

}  // namespace

void Enrolment::SetInventory(const bundle::Inventory& inventory) {
  std::set<std::string> listed;
  for (const bundle::InventoryRobot& robot : inventory.robots) {
    for (const bundle::InventorySensor& sensor : robot.sensors) {
      listed.insert(KeyOf(robot.id, sensor.host, "sensor"));
    }
    for (const std::string& host : robot.actuators) {
      listed.insert(KeyOf(robot.id, host, "actuator"));
    }
  }
  MutexLock lock(&mu_);
  listed_ = std::move(listed);
}

bool Enrolment::IsListed(const std::string& robot, const std::string& host,
                         const std::string& role) {
  MutexLock lock(&mu_);
  return listed_.contains(KeyOf(robot, host, role));
}

absl::Status Enrolment::NotTooSoon(const std::string& who, absl::Duration between) {
  MutexLock lock(&mu_);
  const int64_t now_ns = clock_->Now().boottime_ns;
  const auto last = last_ns_.find(who);
  if (last != last_ns_.end() && now_ns - last->second < absl::ToInt64Nanoseconds(between)) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the last certificate was asked for less than ", absl::FormatDuration(between),
                     " ago; try again after that"));
  }
  if (last_ns_.size() >= kLastMax) last_ns_.clear();
  last_ns_[who] = now_ns;
  return absl::OkStatus();
}

absl::StatusOr<NewToken> Enrolment::CreateToken(const TokenOrder& order) {
  std::vector<std::string> roles = order.roles;
  for (const std::string& role : roles) {
    if (!IsRole(role)) return absl::InvalidArgumentError("a role is `sensor` or `actuator`");
  }
  if (roles.empty()) {
    for (const char* role : kRoles) {
      if (IsListed(order.robot, order.host, role)) roles.emplace_back(role);
    }
    if (roles.empty()) {
      return absl::NotFoundError(
          absl::StrCat("the inventory lists neither a sensor nor an actuator "
                       "of ",
                       order.robot, " on host ", order.host, "; add it to robots.yaml and reload"));
    }
  }
  for (const std::string& role : roles) {
    if (IsListed(order.robot, order.host, role)) continue;
    return absl::NotFoundError(NotListed(order.robot, order.host, role).message());
  }
  std::sort(roles.begin(), roles.end());
  roles.erase(std::unique(roles.begin(), roles.end()), roles.end());
  const absl::Duration valid =
      order.valid == absl::ZeroDuration() ? kTokenLifeDefault : order.valid;
  if (valid < kTokenLifeMin || valid > kTokenLifeMax) {
    return absl::InvalidArgumentError("a token is valid for 1 minute to 24 hours");
  }
  RIPS_ASSIGN_OR_RETURN(const pki::CertificateRequest request,
                        pki::CertificateRequest::Read(order.request_pem));
  RIPS_ASSIGN_OR_RETURN(const Authority authority,
                        Authority::Read(options_.files, options_.external_ca));
  const absl::Time now = Now();
  NewToken token;
  token.record = {.id = NewId().substr(0, kTokenIdDigits),
                  .robot = order.robot,
                  .host = order.host,
                  .roles = absl::StrJoin(roles, ","),
                  .by = order.by,
                  .time_unix_ns = absl::ToUnixNanos(now)};
  RIPS_ASSIGN_OR_RETURN(pki::Issued issued,
                        Sign(authority,
                             {.request = &request,
                              .request_pem = order.request_pem,
                              .identity = {.role = rpc::Role::kEnrolment,
                                           .trust_domain = options_.trust_domain,
                                           .name = token.record.id},
                              .holder = {order.robot, order.host},
                              .life = valid},
                             now, ports_));
  // A program's certificate may be good for a day longer; the token is not.
  token.record.expires_unix_ns = absl::ToUnixNanos(std::min(issued.not_after, now + valid));
  RIPS_RETURN_IF_ERROR(store_->PutToken(token.record));
  token.fetched = {{}, std::move(issued.certificates_pem), authority.ca_pem()};
  return token;
}

absl::Status Enrolment::RevokeToken(const std::string& id) { return store_->RevokeToken(id); }

absl::Status Enrolment::CheckNotBanned(const rpc::PeerIdentity& agent,
                                       const std::string& made_by) const {
  if (ports_.is_banned(agent, "")) {
    return absl::PermissionDeniedError(
        absl::StrCat(rpc::ToString(agent), " is banned; see `ripsctl agent list`"));
  }
  // As rpc::Describe writes it.
  const std::vector<std::string> maker = absl::StrSplit(made_by, " serial ");
  const auto identity = rpc::ParseSpiffeUri(maker.front());
  if (identity.ok() && ports_.is_banned(*identity, maker.back())) {
    return absl::PermissionDeniedError(
        "the administrator who made the token is banned; ask another for a new one");
  }
  return absl::OkStatus();
}

absl::StatusOr<std::optional<Fetched>> Enrolment::GivenBefore(const rpc::PeerIdentity& identity,
                                                              const std::string& token,
                                                              const std::string& key_hash,
                                                              const std::string& ca_pem) {
  absl::StatusOr<store::IssuedRecord> found = store_->FindIssued(token, rpc::ToString(identity));
  if (absl::IsNotFound(found.status())) return std::nullopt;
  if (!found.ok()) return found.status();
  if (found->key_hash != key_hash) {
    const std::string text =
        absl::StrCat("the token was used already, by another key, for ", found->uri);
    ports_.tell(identity.robot, engine::Severity::kHigh,
                absl::StrCat("token ", token, ": ", text, " (serial ", found->serial,
                             "): it is in two hands; ban ", found->uri,
                             " unless that certificate is on the robot, and make a new token"));
    return absl::FailedPreconditionError(
        absl::StrCat(text, "; if that was not this robot, ban that certificate; make a new token"));
  }
  if (ports_.is_banned(identity, found->serial)) {
    return absl::PermissionDeniedError(
        "the certificate that was fetched with this token is banned; ask for a new token");
  }
  std::string certificates_pem = std::move(found->certificates_pem);
  found->certificates_pem.clear();
  return Fetched{*std::move(found), std::move(certificates_pem), ca_pem};
}

void Enrolment::Report(const rpc::PeerIdentity& identity, const store::IssuedRecord& issued) {
  const absl::StatusOr<std::vector<store::IssuedRecord>> all = store_->ListIssued(issued.uri);
  const auto is_other = [&issued](const store::IssuedRecord& each) {
    return each.serial != issued.serial && each.not_after_unix_ns > issued.time_unix_ns;
  };
  const size_t others =
      all.ok() ? static_cast<size_t>(std::count_if(all->begin(), all->end(), is_other)) : 0;
  const std::string who = absl::StrCat("the ", rpc::RoleName(identity.role), " of ", identity.robot,
                                       " on ", identity.host);
  const std::string still_good = absl::StrCat(
      others, " other certificates of it have not expired; `ripsctl enrol list ", identity.robot,
      "` shows them, and if a key of them is not on the robot, "
      "`ripsctl agent ban ",
      issued.uri, "`");
  if (issued.token.empty()) {
    if (others < kGoodWithoutAlert) return;
    return ports_.tell(identity.robot, engine::Severity::kMedium,
                       absl::StrCat(who, " was renewed more often than it needs: ", still_good));
  }
  const std::string text =
      absl::StrCat(who, " was enrolled with token ", issued.token, ": serial ", issued.serial);
  ports_.tell(identity.robot, others == 0 ? engine::Severity::kLow : engine::Severity::kMedium,
              others == 0 ? text : absl::StrCat(text, "; ", still_good));
}

absl::StatusOr<pki::Issued> Enrolment::SignNew(const Authority& authority,
                                               const SigningOrder& order) {
  const std::string uri = rpc::ToString(order.identity);
  RIPS_ASSIGN_OR_RETURN(const std::set<std::string> before, SerialsOf(uri, *store_, Now()));
  RIPS_ASSIGN_OR_RETURN(pki::Issued issued, Sign(authority, order, Now(), ports_));
  // A program takes its time; much can happen meanwhile.
  if (ports_.is_banned(order.identity, issued.serial)) {
    return absl::PermissionDeniedError(absl::StrCat(uri, " is banned; see `ripsctl agent list`"));
  }
  if (!before.contains(issued.serial)) return issued;
  const absl::Status repeated = absl::FailedPreconditionError(
      absl::StrCat("the certificate authority of the policy server gave a wrong certificate: its "
                   "serial number ",
                   issued.serial, " is that of an earlier one"));
  ports_.tell(order.holder.robot, engine::Severity::kHigh,
              absl::StrCat("no certificate for ", uri, ": ", repeated.message()));
  return repeated;
}

absl::StatusOr<Fetched> Enrolment::Issue(const rpc::PeerIdentity& identity,
                                         const std::string& token, const std::string& request_pem) {
  RIPS_ASSIGN_OR_RETURN(const pki::CertificateRequest request,
                        pki::CertificateRequest::Read(request_pem));
  const auto claim = ongoing_.TryClaim(absl::StrCat(token, " ", rpc::ToString(identity)));
  if (claim == nullptr) {
    return absl::UnavailableError(
        "another call for this certificate has not ended yet; try again later");
  }
  RIPS_ASSIGN_OR_RETURN(const Authority authority,
                        Authority::Read(options_.files, options_.external_ca));
  if (!token.empty()) {
    RIPS_ASSIGN_OR_RETURN(std::optional<Fetched> before,
                          GivenBefore(identity, token, request.key_hash(), authority.ca_pem()));
    if (before.has_value()) return *std::move(before);
  }
  RIPS_ASSIGN_OR_RETURN(const pki::Issued issued,
                        SignNew(authority, {.request = &request,
                                            .request_pem = request_pem,
                                            .identity = identity,
                                            .holder = {identity.robot, identity.host},
                                            .life = options_.life}));
  store::IssuedRecord record{.uri = rpc::ToString(identity),
                             .serial = issued.serial,
                             .key_hash = request.key_hash(),
                             .token = token,
                             .time_unix_ns = absl::ToUnixNanos(Now()),
                             .not_after_unix_ns = absl::ToUnixNanos(issued.not_after),
                             .certificates_pem = issued.certificates_pem};
  if (const absl::Status put = store_->PutIssued(record); !put.ok()) {
    LogWarning("a signed certificate was not handed out",
               {{"uri", record.uri}, {"serial", record.serial}, {"why", put.message()}});
    return put;
  }
  record.certificates_pem.clear();
  LogInfo("issued a certificate", {{"uri", record.uri},
                                   {"serial", record.serial},
                                   {"until", UtcText(issued.not_after)},
                                   {"token", token}});
  if (const auto peer = rpc::ReadLeaf(issued.certificates_pem); peer.ok()) ports_.issued(*peer);
  Report(identity, record);
  return Fetched{std::move(record), issued.certificates_pem, authority.ca_pem()};
}

absl::StatusOr<Fetched> Enrolment::Enrol(const rpc::PeerIdentity& token, const std::string& role,
                                         const std::string& request_pem) {
  if (!IsRole(role)) return absl::InvalidArgumentError("a role is `sensor` or `actuator`");
  absl::StatusOr<store::TokenRecord> found = store_->FindToken(token.name);
  if (absl::IsNotFound(found.status())) {
    return absl::PermissionDeniedError("this server does not know the token (any more)");
  }
  if (!found.ok()) return found.status();
  if (found->revoked) return absl::PermissionDeniedError("the token is revoked");
  if (absl::ToUnixNanos(Now()) >= found->expires_unix_ns) {
    return absl::PermissionDeniedError("the token has expired; ask an admin for a new one");
  }
  const std::vector<std::string> roles = absl::StrSplit(found->roles, ',');
  if (std::find(roles.begin(), roles.end(), role) == roles.end()) {
    return absl::PermissionDeniedError(
        absl::StrCat("the token is for ", found->roles, ", not for ", role));
  }
  if (!IsListed(found->robot, found->host, role)) {
    return NotListed(found->robot, found->host, role);
  }
  const rpc::PeerIdentity agent{
      .role = role == "sensor" ? rpc::Role::kSensor : rpc::Role::kActuator,
      .trust_domain = options_.trust_domain,
      .robot = found->robot,
      .host = found->host};
  RIPS_RETURN_IF_ERROR(CheckNotBanned(agent, found->by));
  RIPS_RETURN_IF_ERROR(NotTooSoon(absl::StrCat(token.name, "/", role), kBetweenFetches));
  return Issue(agent, found->id, request_pem);
}

absl::StatusOr<Fetched> Enrolment::Renew(const rpc::PeerIdentity& agent,
                                         const std::string& request_pem) {
  const std::string role(rpc::RoleName(agent.role));
  if (!IsRole(role)) return absl::PermissionDeniedError("only agents renew certificates");
  if (!IsListed(agent.robot, agent.host, role)) return NotListed(agent.robot, agent.host, role);
  RIPS_RETURN_IF_ERROR(NotTooSoon(rpc::ToString(agent), kBetweenRenewals));
  return Issue(agent, "", request_pem);
}

}  // namespace rips::enrol
