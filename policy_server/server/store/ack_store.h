// Acknowledgements of alerts, which WriteBatch::acks writes, and the search for alerts.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_ACK_STORE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_ACK_STORE_H_

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "policy_server/server/store/ack_records.h"
#include "policy_server/server/store/records.h"

namespace rips::store {

// The newest alerts among which a search by severity, rule or time looks; bounds what it costs. One
// robot keeps fewer. A search for high and critical ones alone looks at so many of these.
inline constexpr int64_t kAlertsSearchedMax = 20'000;

// Which alerts are wanted; all conditions together.
struct AlertQuery {
  // Empty = of all robots.
  std::string robot;
  // As ListLimit.
  uint32_t limit = 0;
  // Only those that are not acknowledged.
  bool open = false;
  // One of these; empty = any.
  std::vector<std::string> severities;
  // Empty = any.
  std::string rule;
  // At this time or later; 0 = any.
  int64_t since_unix_ns = 0;

  // It has a condition that no index serves.
  bool searches() const { return !severities.empty() || !rule.empty() || since_unix_ns != 0; }
};

struct AlertList {
  // The one written last first.
  std::vector<AlertRecord> alerts;
  // There are fewer than the limit, and alerts older than the newest kAlertsSearchedMax.
  bool older_not_searched = false;
};

// At most one acknowledgement of each alert that a Store keeps; it is forgotten with the alert.
// Errors as for Store.
class AckStore {
 public:
  virtual ~AckStore() = default;
  // Those that there are of these alerts, in the order of the ids.
  virtual absl::StatusOr<std::vector<AckRecord>> FindAcks(
      std::span<const std::string> alert_ids) = 0;
  virtual absl::StatusOr<AlertList> SearchAlerts(const AlertQuery& query) = 0;
};

// Whether severity, rule and time are as the query wants them.
bool Matches(const AlertQuery& query, const AlertRecord& alert);

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_ACK_STORE_H_
