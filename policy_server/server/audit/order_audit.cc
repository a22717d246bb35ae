#include "policy_server/server/audit/order_audit.h"

#include <optional>
#include <utility>

#include "google/protobuf/descriptor.h"

namespace rips::audit {
namespace {

// The request of one who is refused may be of any size.
constexpr size_t kRequestBytesMax = 16 * 1024;

}  // namespace

void OrderAudit::Record(const Order& order) {
  const std::optional<uint64_t> left_out =
      order.status.ok() ? std::optional<uint64_t>(0) : refused_.Admit(order.caller);
  if (!left_out) return;
  v1::AuditRecord record;
  record.set_time_unix_ns(clock_->Now().unix_ns);
  record.set_kind(v1::AuditRecord::KIND_CALL);
  record.set_actor(order.caller);
  record.set_address(order.address);
  record.set_action(std::string(order.call));
  record.set_count(1 + *left_out);
  record.set_outcome(order.status.ok() ? "admitted" : order.status.ToString());
  if (order.request.ByteSizeLong() <= kRequestBytesMax) {
    record.set_text(order.request.ShortDebugString());
    const auto* robot = order.request.GetDescriptor()->FindFieldByName("robot");
    if (!order.robot.empty()) {
      record.set_robot(order.robot);
    } else if (robot != nullptr) {
      record.set_robot(order.request.GetReflection()->GetString(order.request, robot));
    }
  }
  log_->Add(std::move(record));
}

}  // namespace rips::audit
