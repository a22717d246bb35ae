// SetMaintenance: on the robot's thread, as all orders.
#include <algorithm>
#include <string>
#include <utility>

#include "policy_server/server/operator_api/answer_limits.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/robot/context/maintenance_window.h"
#include "services/runtime/log.h"

namespace rips::operator_api {
namespace {

// What does not fit is above the longest maintenance, and refused for that.
int64_t ToNanos(uint64_t ms) {
  constexpr uint64_t kMsMax = pipeline::kMaintenanceNsMax / kNanosPerMilli;
  return static_cast<int64_t>(std::min(ms, kMsMax + 1)) * kNanosPerMilli;
}

}  // namespace

grpc::ServerUnaryReactor* OperatorService::SetMaintenance(
    grpc::CallbackServerContext* context, const rips::v1::SetMaintenanceRequest* request,
    rips::v1::SetMaintenanceResponse* response) {
  const auto who =
      AuthorizeOrder(context, "SetMaintenance", *request, rpc::OperatorRole::kOperator);
  if (!who.ok()) return Refuse(context, who.status());
  LogInfo(request->for_ms() == 0 ? "operator ends a maintenance" : "operator begins a maintenance",
          {{"operator", rpc::Describe(*who)},
           {"robot", request->robot()},
           {"for_ms", request->for_ms()},
           {"reason", request->reason()}});
  auto* reactor = new UnaryCall(who->ticket, who->on_refused);
  pipeline::MaintenanceOrder order{.operator_name = OperatorName(*who),
                                   .reason = request->reason(),
                                   .for_ns = ToNanos(request->for_ms())};
  const absl::Status posted = pipeline_->Post(
      request->robot(), pipeline::Queue::kOrders,
      [reactor, response, order = std::move(order)](pipeline::Robot& robot) {
        const absl::Status set = robot.SetMaintenance(order);
        if (const auto maintenance = robot.Status().maintenance; set.ok() && maintenance) {
          *response->mutable_maintenance() = Encode(*maintenance);
        }
        reactor->End(set);
      });
  if (!posted.ok()) reactor->End(posted);
  return reactor;
}

}  // namespace rips::operator_api
