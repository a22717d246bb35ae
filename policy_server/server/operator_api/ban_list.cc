#include "policy_server/server/operator_api/ban_list.h"

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/rpc/identity.h"

namespace rips::operator_api {

absl::StatusOr<std::unique_ptr<BanList>> BanList::Load(store::BanStore* store) {
  RIPS_ASSIGN_OR_RETURN(const std::vector<store::BanRecord> stored, store->ListBans());
  std::unique_ptr<BanList> list(new BanList(store));
  MutexLock lock(&list->mu_);
  for (const store::BanRecord& ban : stored) list->bans_[{ban.uri, ban.serial}] = ban;
  return list;
}

absl::Status BanList::Ban(const store::BanRecord& ban) {
  RIPS_ASSIGN_OR_RETURN(const rpc::PeerIdentity identity, rpc::ParseSpiffeUri(ban.uri));
  if (identity.role == rpc::Role::kPolicyServer) {
    return absl::InvalidArgumentError("a policy server is revoked by the authority, not banned");
  }
  if (ban.serial.find_first_not_of("0123456789abcdef") != std::string::npos ||
      ban.serial.size() > 64) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", ban.serial, "` is not a serial number in lower-case hex"));
  }
  {
    MutexLock lock(&mu_);
    if (bans_.size() >= kBansMax) {
      return absl::ResourceExhaustedError(
          absl::StrCat(kBansMax, " bans are in force already, the limit; revoke at the authority"));
    }
    bans_[{ban.uri, ban.serial}] = ban;
  }
  const absl::Status stored = store_->PutBan(ban);
  if (stored.ok()) return stored;
  return absl::Status(stored.code(),
                      absl::StrCat("in force, but lost at the next start: ", stored.message()));
}

absl::Status BanList::Unban(const std::string& uri, const std::string& serial) {
  RIPS_ASSIGN_OR_RETURN(const bool removed, store_->RemoveBan(uri, serial));
  MutexLock lock(&mu_);
  const bool known = bans_.erase({uri, serial}) > 0;
  if (removed || known) return absl::OkStatus();
  return absl::NotFoundError(absl::StrCat("no ban of `", uri, "`",
                                          serial.empty() ? "" : absl::StrCat(" serial ", serial)));
}

std::vector<store::BanRecord> BanList::bans() const {
  std::vector<store::BanRecord> bans;
  MutexLock lock(&mu_);
  for (const auto& [key, ban] : bans_) bans.push_back(ban);
  return bans;
}

std::optional<rpc::Refusal> BanList::Against(const rpc::Peer& peer) const {
  MutexLock lock(&mu_);
  if (bans_.empty()) return std::nullopt;
  const std::string uri = rpc::ToString(peer.identity);
  if (!bans_.contains({uri, ""}) && !bans_.contains({uri, peer.serial})) return std::nullopt;
  return rpc::Refusal{"banned", absl::PermissionDeniedError("the certificate is banned")};
}

}  // namespace rips::operator_api
