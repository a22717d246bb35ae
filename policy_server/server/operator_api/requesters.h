// Who an operator is to robots and records, and who asked for the lowerings that wait for a second
// operator.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_REQUESTERS_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_REQUESTERS_H_

#include <cstddef>
#include <deque>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/container/flat_hash_map.h"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "services/rpc/call_gate.h"
#include "services/rpc/identity.h"
#include "services/rpc/peer.h"
#include "services/runtime/mutex.h"

namespace rips::operator_api {

// What records name: `alice (spiffe://td/operator/admin/alice serial 0f)`.
std::string OperatorName(const rpc::Peer& peer);
// Who it is, whatever role the certificate has: `td/alice`.
std::string IdentityOf(const rpc::PeerIdentity& identity);

// A request id as robots see it, so that none repeats the answer of another operator or call.
std::string RequestKey(const rpc::Peer& peer, absl::string_view call, const std::string& id);

// Any thread.
class Requesters {
 public:
  // More than can wait on all robots of a server; the oldest goes for one more.
  static constexpr size_t kMax = 40'000;

  // The lowering that waits under `id` was asked for with that certificate.
  void Add(const std::string& id, const rpc::Peer& peer) ABSL_LOCKS_EXCLUDED(mu_);
  // Whether it may be approved yet. FailedPrecondition: that certificate does not count any more.
  // NotFound: nothing is known of `id`.
  absl::Status Check(const std::string& id, const rpc::CallGate& gate) const
      ABSL_LOCKS_EXCLUDED(mu_);

 private:
  mutable Mutex mu_;
  absl::flat_hash_map<std::string, rpc::Peer> peers_ ABSL_GUARDED_BY(mu_);
  // Oldest first.
  std::deque<std::string> order_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_REQUESTERS_H_
