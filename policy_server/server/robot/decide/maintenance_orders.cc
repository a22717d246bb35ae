#include "policy_server/server/robot/decide/maintenance_orders.h"

#include <algorithm>
#include <iterator>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/robot/decide/orders.h"
#include "services/base/status_macros.h"

namespace rips::pipeline {

void MaintenanceOrders::OnSet(const input::SetMaintenance& in) {
  context_.Do(action::AnswerOrder{in.token, {.status = Set(in.order)}});
}

absl::Status MaintenanceOrders::NotTooOften(const std::string& operator_name) {
  const int64_t now_ns = context_.now_ns();
  for (auto it = changes_.begin(); it != changes_.end();) {
    Changes& each = it->second;
    const auto passed_ns = static_cast<double>(now_ns - each.at_ns);
    each.left = std::min(kMaintenanceChangesMax, each.left + passed_ns / kMaintenanceChangeEveryNs);
    each.at_ns = now_ns;
    it = each.left >= kMaintenanceChangesMax ? changes_.erase(it) : std::next(it);
  }
  Changes& changes = changes_.try_emplace(operator_name, Changes{.at_ns = now_ns}).first->second;
  if (changes.left < 1) {
    return absl::ResourceExhaustedError(
        absl::StrCat("you change the maintenance of ", context_.config.id, " too often: after ",
                     kMaintenanceChangesMax, " times, once in ",
                     kMaintenanceChangeEveryNs / kNanosPerSecond, " s; try again later"));
  }
  changes.left -= 1;
  return absl::OkStatus();
}

absl::Status MaintenanceOrders::Set(const MaintenanceOrder& order) {
  RIPS_RETURN_IF_ERROR(Orders::CheckReason(order.reason));
  RIPS_RETURN_IF_ERROR(NotTooOften(order.operator_name));
  if (order.for_ns != 0) return Begin(order);
  if (!window_.At(context_.now())) {
    return absl::FailedPreconditionError(absl::StrCat(context_.config.id, " is in no maintenance"));
  }
  window_.End();
  outbox_.Touch(&DurableOutbox::Unsaved::maintenance);
  ReportEnd(absl::StrCat("maintenance ended by ", order.operator_name),
            absl::StrCat("operator ", order.operator_name, " ends the maintenance of ",
                         context_.config.id, ": ", order.reason));
  return absl::OkStatus();
}

absl::Status MaintenanceOrders::Begin(const MaintenanceOrder& order) {
  if (!context_.moment.store_writable) {
    return absl::FailedPreconditionError(
        "the server's store cannot be written, and a maintenance must be recorded");
  }
  // One that is over by now has its own alert.
  Expire();
  const std::optional<store::Maintenance> before = window_.At(context_.now());
  RIPS_RETURN_IF_ERROR(
      window_.Begin(order.for_ns, order.operator_name, order.reason, context_.now()));
  outbox_.Touch(&DurableOutbox::Unsaved::maintenance);
  alerts_.RaiseOfKind(
      absl::StrCat("maintenance begun by ", order.operator_name), engine::Severity::kMedium,
      absl::StrCat("operator ", order.operator_name, " puts ", context_.config.id,
                   " in maintenance until ", UtcText(window_.At(context_.now())->until_unix_ns),
                   before ? absl::StrCat(", instead of until ", UtcText(before->until_unix_ns),
                                         " (asked by ", ShortName(before->by), ")")
                          : "",
                   "; alerts of absent agents have the severity info until then: ", order.reason));
  return absl::OkStatus();
}

void MaintenanceOrders::Expire() {
  const std::optional<store::Maintenance> over = window_.PopOver(context_.now());
  if (!over) return;
  outbox_.Touch(&DurableOutbox::Unsaved::maintenance);
  ReportEnd("maintenance over",
            absl::StrCat("the maintenance of ", context_.config.id, " is over (asked by ",
                         ShortName(over->by), ": ", over->reason, ")"));
}

void MaintenanceOrders::ReportEnd(const std::string& kind, const std::string& text) {
  std::vector<std::string> lost;
  for (const auto& [name, host] : sensors_.hosts()) {
    if (host.lost) lost.push_back(absl::StrCat("sensor ", name));
  }
  for (const std::string& name : actuators_.lost()) lost.push_back(absl::StrCat("actuator ", name));
  if (lost.empty()) {
    alerts_.RaiseOfKind(kind, engine::Severity::kInfo, text);
    return;
  }
  // Not of one kind with an end at which nothing is wrong.
  alerts_.RaiseOfKind(
      absl::StrCat(kind, ", agents lost"), engine::Severity::kHigh,
      absl::StrCat("still absent after maintenance: ", absl::StrJoin(lost, ", "), "; ", text));
}

}  // namespace rips::pipeline
