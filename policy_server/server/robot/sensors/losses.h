// What was not judged or not inspected: counted, reported, and an event for rules. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_LOSSES_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_LOSSES_H_

#include <cstdint>
#include <string>

#include "absl/container/btree_map.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/evidence_gate.h"
#include "policy_server/server/robot/sensors/loss_alarm.h"
#include "policy_server/server/robot/sensors/sensor_host.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Losses {
 public:
  Losses(Context* context, Alerts* alerts, EvidenceGate* evidence)
      : context_(*context), alerts_(*alerts), evidence_(*evidence) {}

  // Observations that the hello leaves out and that are lost: neither with the sensor nor judged.
  // Of each range, `judged` from the store, `acknowledged` and `first` as the sensor says:
  //   first <= judged + 1                    nothing is missing
  //   acknowledged <= judged < first - 1     lost: dropped by the sensor before it was acknowledged
  //   judged < acknowledged                  the store went back; lost, once, only what lies above
  //   of a former process of the sensor,     it names a point that the store does not go on from:
  //   nothing acknowledged                   not lost, once; its knowledge ended with that process
  // An excuse is for what lies before the first hello to this process of the server: the sensor
  // learns our generation by the answer, and one that names another again has lost what is missing.
  uint64_t LostBefore(SensorHost& host, const input::SensorHello& in);
  // Numbers that a sensor gave and that will not come: counted here, once. Its own Loss records
  // tell of what never had a number.
  void OnMissing(SensorHost& host, uint64_t count);
  // A Loss record of the sensor.
  void OnLoss(SensorHost& host, const LossSeen& loss);
  // A message has no verdict of so many inspections.
  void OnSkipped(const MessageSeen& message, uint64_t inspections);

  // Call at least once a second.
  void Report();
  // Inspections that were not made in the last ten minutes, by reason.
  absl::btree_map<std::string, uint64_t> Skipped() const;
  // Their reasons; empty = every message was inspected.
  std::string SkippedText() const;

 private:
  void Count(SensorHost& host, uint64_t count);
  void OnStoreWentBack(const std::string& how);

  Context& context_;
  Alerts& alerts_;
  EvidenceGate& evidence_;
  LossAlarm alarm_;
  // Reported once, until the next start.
  bool store_went_back_ = false;
  absl::btree_map<std::string, RecentLosses> skipped_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_LOSSES_H_
