// The server's audit log as its parts use it: what commits and operators' calls leave in it.
#ifndef RIPS_POLICY_SERVER_SERVER_AUDIT_ORDER_AUDIT_H_
#define RIPS_POLICY_SERVER_SERVER_AUDIT_ORDER_AUDIT_H_

#include <cstdint>
#include <memory>
#include <string>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "google/protobuf/message.h"
#include "policy_server/server/audit/audit_log.h"
#include "services/base/clock.h"
#include "services/runtime/log_limiter.h"
#include "services/runtime/mutex.h"
#include "services/runtime/ticker.h"

namespace rips::audit {

// A call of an operator, as it came in; views what lives as long as the call.
struct Order {
  // URI and serial of the certificate; empty if there is none that names an operator.
  std::string caller;
  std::string address;
  // As the proto names it.
  absl::string_view call;
  const google::protobuf::Message& request;
  // OK: admitted. One that is refused after that is recorded a second time.
  absl::Status status;
  // Empty: `robot` of the request, if it has one.
  std::string robot = {};
};

class OrderAudit {
 public:
  // Nothing is owned; both outlive this.
  OrderAudit(AuditLog* log, const Clock* clock);
  // Records what is still only counted.
  ~OrderAudit();

  // Of a certificate that is refused one call again and again, 50 and then one in 30 s with their
  // count. Any thread; never blocks on the disk.
  void Record(const Order& order) ABSL_LOCKS_EXCLUDED(mu_);
  // Of the calls left out, what no further call of the kind has brought into the log for so long.
  // The audit does it by itself.
  void RecordLeftOut(int64_t for_ns) ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct LeftOut {
    // The first one.
    v1::AuditRecord record;
    int64_t since_ns = 0;
  };

  AuditLog* log_;
  const Clock* clock_;
  LogLimiter refused_{50, 1.0 / 30};
  Mutex mu_;
  // By certificate and call, as the limiter tells them apart.
  absl::btree_map<std::string, LeftOut> left_out_ ABSL_GUARDED_BY(mu_);
  Ticker ticker_;  // last: uses the others
};

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_SERVER_AUDIT_ORDER_AUDIT_H_
