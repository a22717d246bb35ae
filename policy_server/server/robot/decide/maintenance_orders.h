// Begins and ends a robot's maintenance, and reports it:
//
//   event                              alert
//   an operator begins or replaces it  medium
//   it ends, by an operator or by time info; high, naming them, if agents are lost: their alerts
//                                      of absence were info
//
// Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_MAINTENANCE_ORDERS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_MAINTENANCE_ORDERS_H_

#include <cstdint>
#include <map>
#include <string>

#include "absl/status/status.h"
#include "policy_server/server/robot/actuators/actuator_side.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/durable_outbox.h"
#include "policy_server/server/robot/context/maintenance_window.h"
#include "policy_server/server/robot/sensors/sensor_side.h"
#include "services/base/clock.h"

namespace rips::pipeline {

// Changes of one operator at once, and how often one more: fewer than the limit of their alerts, so
// that none is folded away.
inline constexpr double kMaintenanceChangesMax = 6;
inline constexpr int64_t kMaintenanceChangeEveryNs = 10 * kNanosPerSecond;

// Not thread-safe. All that it is given outlives it.
class MaintenanceOrders {
 public:
  MaintenanceOrders(Context* context, MaintenanceWindow* window, Alerts* alerts,
                    DurableOutbox* outbox, const SensorSide* sensors, const ActuatorSide* actuators)
      : context_(*context),
        window_(*window),
        alerts_(*alerts),
        outbox_(*outbox),
        sensors_(*sensors),
        actuators_(*actuators) {}

  // Answered at once. InvalidArgument for a reason or a duration out of its limits;
  // ResourceExhausted for an operator who changes it too often;
  // FailedPrecondition to begin one while the store cannot be written, or to end one if there is
  // none.
  void OnSet(const input::SetMaintenance& in);
  // Reports one that is over by time.
  void Expire();

 private:
  struct Changes {
    double left = kMaintenanceChangesMax;
    int64_t at_ns = 0;
  };

  absl::Status NotTooOften(const std::string& operator_name);
  absl::Status Set(const MaintenanceOrder& order);
  absl::Status Begin(const MaintenanceOrder& order);
  // An alert of the end, which `text` says. `kind` as of Alerts::RaiseOfKind.
  void ReportEnd(const std::string& kind, const std::string& text);

  Context& context_;
  MaintenanceWindow& window_;
  Alerts& alerts_;
  DurableOutbox& outbox_;
  const SensorSide& sensors_;
  const ActuatorSide& actuators_;
  // Of operators with fewer left than the most.
  std::map<std::string, Changes> changes_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_MAINTENANCE_ORDERS_H_
