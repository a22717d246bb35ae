#include "policy_server/server/operator_api/requesters.h"

#include <optional>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"

namespace rips::operator_api {

std::string OperatorName(const rpc::Peer& peer) {
  return absl::StrCat(peer.identity.name, " (", rpc::Describe(peer), ")");
}

std::string IdentityOf(const rpc::PeerIdentity& identity) {
  return absl::StrCat(identity.trust_domain, "/", identity.name);
}

std::string RequestKey(const rpc::Peer& peer, absl::string_view call, const std::string& id) {
  if (id.empty()) return "";
  return absl::StrCat(IdentityOf(peer.identity), " ", call, " ", id);
}

void Requesters::Add(const std::string& id, const rpc::Peer& peer) {
  MutexLock lock(&mu_);
  if (!peers_.insert_or_assign(id, peer).second) return;
  order_.push_back(id);
  if (order_.size() <= kMax) return;
  peers_.erase(order_.front());
  order_.pop_front();
}

absl::Status Requesters::Check(const std::string& id, const rpc::CallGate& gate) const {
  std::optional<rpc::Peer> peer;
  {
    MutexLock lock(&mu_);
    if (const auto it = peers_.find(id); it != peers_.end()) peer = it->second;
  }
  if (!peer.has_value()) {
    return absl::NotFoundError(
        absl::StrCat("no lowering waits under `", absl::CHexEscape(id), "`"));
  }
  const std::optional<rpc::Refusal> against = gate.Against(*peer);
  if (!against.has_value()) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat("it was asked for with a certificate that does not count any more (",
                   against->reason, "); another operator must ask for it again"));
}

}  // namespace rips::operator_api
