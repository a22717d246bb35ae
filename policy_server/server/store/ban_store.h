// The deny list of certificates.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_BAN_STORE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_BAN_STORE_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::store {

// A certificate identity that is not served any more.
struct BanRecord {
  // As rpc::ToString gives it.
  std::string uri;
  // Lower-case hex; empty = whatever certificate the identity shows.
  std::string serial;
  std::string reason;
  // Who banned it, as rpc::Describe gives it.
  std::string by;
  int64_t time_unix_ns = 0;

  friend bool operator==(const BanRecord&, const BanRecord&) = default;
};

// Deny list. Durable when a method returns OK; errors as for Store.
class BanStore {
 public:
  virtual ~BanStore() = default;
  // In place of one of the same URI and serial. InvalidArgument without a URI.
  virtual absl::Status PutBan(const BanRecord& ban) = 0;
  // False if there was none.
  virtual absl::StatusOr<bool> RemoveBan(absl::string_view uri, absl::string_view serial) = 0;
  // Sorted by URI and serial.
  virtual absl::StatusOr<std::vector<BanRecord>> ListBans() = 0;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_BAN_STORE_H_
