// The server's audit log as its parts use it: what commits and operators' calls leave in it.
#ifndef RIPS_POLICY_SERVER_SERVER_AUDIT_ORDER_AUDIT_H_
#define RIPS_POLICY_SERVER_SERVER_AUDIT_ORDER_AUDIT_H_

#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "google/protobuf/message.h"
#include "policy_server/server/audit/audit_log.h"
#include "services/base/clock.h"
#include "services/runtime/log_limiter.h"

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
  OrderAudit(AuditLog* log, const Clock* clock) : log_(log), clock_(clock) {}

  // Of a certificate that is refused one call again and again, 50 and then one in 30 s with their
  // count. Any thread; never blocks on the disk.
  void Record(const Order& order);

 private:
  AuditLog* log_;
  const Clock* clock_;
  LogLimiter refused_{50, 1.0 / 30};
};

}  // namespace rips::audit

#endif  // RIPS_POLICY_SERVER_SERVER_AUDIT_ORDER_AUDIT_H_
