// The deny list in force: what the store holds, in memory, asked for every call.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_BAN_LIST_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_BAN_LIST_H_

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/server/store/ban_store.h"
#include "policy_server/server/store/store.h"
#include "services/rpc/call_gate.h"
#include "services/runtime/mutex.h"

namespace rips::operator_api {

// Any thread; Ban and Unban block on the disk.
class BanList {
 public:
  // Bans at one time; one more is refused.
  static constexpr size_t kBansMax = 10'000;

  // `store` is not owned and outlives this. Errors of the store: who is banned must be known.
  static absl::StatusOr<std::unique_ptr<BanList>> Load(store::BanStore* store);

  // In force when it returns anything but InvalidArgument and ResourceExhausted; durable if that is
  // OK. InvalidArgument if the URI is no identity of ours, or a policy server's.
  absl::Status Ban(const store::BanRecord& ban) ABSL_LOCKS_EXCLUDED(mu_);
  // NotFound if there is no such ban. Still in force if it is not OK.
  absl::Status Unban(const std::string& uri, const std::string& serial) ABSL_LOCKS_EXCLUDED(mu_);
  // Sorted by URI and serial.
  std::vector<store::BanRecord> bans() const ABSL_LOCKS_EXCLUDED(mu_);

  // A Judge.
  std::optional<rpc::Refusal> Against(const rpc::Peer& peer) const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  explicit BanList(store::BanStore* store) : store_(store) {}

  store::BanStore* store_;
  mutable Mutex mu_;
  std::map<std::pair<std::string, std::string>, store::BanRecord> bans_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_BAN_LIST_H_
