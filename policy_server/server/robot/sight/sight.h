// What of a robot is seen, and what is not although it should be. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_SIGHT_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_SIGHT_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <tuple>
#include <vector>

#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/own_agents.h"
#include "policy_server/server/robot/model/coverage.h"
#include "policy_server/server/robot/sensors/sensor_side.h"
#include "policy_server/server/robot/sight/graph_health.h"
#include "policy_server/server/robot/sight/truncation_alarm.h"
#include "services/ros2/guid.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class Sight {
 public:
  // `graph`: the one in force.
  Sight(Context* context, Alerts* alerts, OwnAgents* own_agents, SensorSide* sensors,
        const engine::CurrentGraph* graph)
      : context_(*context),
        alerts_(*alerts),
        own_agents_(*own_agents),
        sensors_(*sensors),
        graph_(*graph) {}

  // Finds what is not seen now. Call it when the graph, the parts of actuators or what a sensor
  // says of its inputs may have changed, before the evidence is asked for.
  void Update();
  // The sensor has said what it cannot see.
  void OnState(const SensorHost& host);
  // A payload was cut on the robot.
  void OnMessage(const MessageSeen& message);
  // Raises the alerts that are due. `parts_verified`: an actuator has read back, from the parts
  // whose modes it sets, that they are where they must be. Call at least once a second.
  void Report(bool parts_verified);

  // Why the robot, or an input that a sensor was told to watch, is not seen; printable.
  const std::vector<std::string>& blind() const { return blind_; }
  // Topics of which payloads were cut in the last ten minutes.
  std::vector<CutPayloads::Topic> CutTopics() const;
  std::vector<SensorCoverage> Coverage() const;   // of every sensor host, sorted
  std::vector<SensorInterest> Interests() const;  // of sensors that report messages

 private:
  void ExamineGraph();
  void CountLeftOut(uint64_t left_out, bool began);
  void ReportTruncated();
  void RecoverTruncated();
  void ReportBlind(bool parts_verified);
  void ReportCoverage();

  Context& context_;
  Alerts& alerts_;
  OwnAgents& own_agents_;
  SensorSide& sensors_;
  const engine::CurrentGraph& graph_;
  std::vector<std::string> blind_;
  std::optional<size_t> blind_counted_;
  BlindAlarm blind_alarm_;
  GraphHealth health_;
  // What health_ was found from: revision, participants and parts of our agents, domain, whether
  // its addresses have changed.
  std::tuple<uint64_t, std::vector<ros2::Guid>, std::vector<std::string>, uint32_t, bool>
      examined_ = {};
  TruncationAlarm truncation_alarm_;
  std::optional<uint64_t> left_out_counted_;
  // The sensor is not asked for its graph again before.
  int64_t next_recovery_ns_ = 0;
  CutPayloads cut_payloads_;
  CoverageAlarm coverage_alarm_;
  // Of the graph whose endpoints were counted last, and the participants left out.
  uint64_t counted_revision_ = 0;
  std::vector<ros2::Guid> counted_without_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SIGHT_SIGHT_H_
