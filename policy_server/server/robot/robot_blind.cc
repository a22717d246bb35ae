// Robot: what is not seen although it should be, and who hears of it.
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/robot/robot.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {
namespace {

// Of one sensor's reasons, so that a hostile one cannot fill the status.
constexpr size_t kReasonsShown = 16;
// Between two snapshots that are asked for because the graph is truncated.
constexpr int64_t kRecoveryNs = 60 * kNanosPerSecond;

void CountLeftOut(const Counts& counts, const std::string& robot, uint64_t left_out, bool began,
                  Sight& sight) {
  if (std::exchange(sight.left_out_counted, left_out) == left_out) return;
  if (counts.graph_left_out) counts.graph_left_out(robot, left_out, began);
}

}  // namespace

void Robot::ExamineOwnGraph() {
  const auto primary = sensors_.find(config_.primary_sensor);
  // Without a settled graph there is another evidence problem already, and nothing to examine.
  if (primary == sensors_.end() || !primary->second.session || !primary->second.settled) {
    sight_.graph_health = {};
    sight_.graph_examined = {};
    // Of a sensor that is away, what was left out last stands.
    return CountLeftOut(ports_.counts, config_.id, sight_.left_out_counted.value_or(0), false,
                        sight_);
  }
  const uint32_t domain = primary->second.session->domain;
  const std::tuple<uint64_t, uint64_t, uint32_t> now = {state_.graph.revision(),
                                                        sight_.actuator_hellos, domain};
  if (now == sight_.graph_examined) return;
  sight_.graph_examined = now;
  sight_.graph_health = ExamineGraph(graph(), {.sensor = primary->first,
                                               .domain = domain,
                                               .own_participants = Participants(),
                                               .parts = ProtectedParts()});
  const ros2::Truncation truncation = graph().truncation();
  const bool began = sight_.truncation_alarm.Set(truncation, ports_.clock->Now().boottime_ns);
  CountLeftOut(ports_.counts, config_.id, truncation.left_out, began, sight_);
}

void Robot::UpdateBlind(Instant now) {
  ExamineOwnGraph();
  std::vector<std::string> reasons = sight_.graph_health.problems;
  for (const auto& [name, host] : sensors_) {
    if (!host.session) continue;
    const std::vector<std::string>& blind = host.state.blind;
    for (size_t i = 0; i < std::min(blind.size(), kReasonsShown); ++i) {
      reasons.push_back(absl::StrCat("sensor ", name, ": ", ros2::Printable(blind[i])));
    }
    if (blind.size() > kReasonsShown) {
      reasons.push_back(
          absl::StrCat("sensor ", name, ": ", blind.size() - kReasonsShown, " more inputs"));
    }
  }
  sight_.blind_alarm.Set(reasons, now.boottime_ns);
  sight_.blind = std::move(reasons);
  // Has an alert of its own, at once.
  if (!sight_.graph_health.truncated.empty()) sight_.blind.push_back(sight_.graph_health.truncated);
  if (std::exchange(sight_.blind_counted, sight_.blind.size()) == sight_.blind.size()) return;
  if (ports_.counts.blind) ports_.counts.blind(config_.id, sight_.blind.size());
}

bool Robot::PartsVerified(Instant now) const {
  return std::any_of(actuators_.begin(), actuators_.end(), [&](const auto& entry) {
    const ActuatorHost& host = entry.second;
    return ActuatorLive(host, now) && !host.protected_parts.empty() &&
           host.session->heartbeat.verified;
  });
}

void Robot::TellTruncated(Instant now) {
  const TruncationAlarm::Due due = sight_.truncation_alarm.Take(now.boottime_ns);
  if (due.began) {
    OwnAlert(engine::Severity::kCritical,
             absl::StrCat("graph truncated: the graph of sensor ", config_.primary_sensor,
                          " hit a limit (up to ", due.left_out, " left out); ",
                          LargestParticipant(graph()), "; rules lower no level of ", config_.id,
                          " meanwhile, and what they ask of the rest is unscanned"));
  }
  for (const ros2::Truncation::Crowd& crowd : due.crowds) {
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat(DescribeParticipant(graph(), crowd.participant), " holds ",
                          crowd.endpoints, " endpoints of the graph; ", crowd.left_out,
                          " more participants, nodes or endpoints of it are left out"));
  }
  if (due.over) {
    OwnAlert(engine::Severity::kInfo, absl::StrCat("the graph of sensor ", config_.primary_sensor,
                                                   " is whole again; rules have judged it"));
  }
}

void Robot::RecoverTruncated(Instant now) {
  if (sight_.graph_health.truncated.empty() || now.boottime_ns < sight_.next_recovery_ns) return;
  // What the sensor left out, it asks discovery for itself.
  if (graph().dropped() == 0 || !graph().HasRoom()) return;
  sight_.next_recovery_ns = now.boottime_ns + kRecoveryNs;
  SensorHost& host = sensors_[config_.primary_sensor];
  RefuseGraph(host, *host.session,
              absl::AbortedError("the graph hit a limit and there is room again: send it anew"));
}

void Robot::TellBlind(Instant now) {
  TellTruncated(now);
  RecoverTruncated(now);
  const std::vector<std::string> due = sight_.blind_alarm.Due(now.boottime_ns);
  if (!due.empty()) {
    // A robot whose ROS stack is off shows no node either. If an actuator reads the modes of its
    // parts all the same, the robot runs and the sensor looks elsewhere.
    const bool may_be_off =
        sight_.graph_health.empty && sight_.blind.size() == 1 && !PartsVerified(now);
    OwnAlert(may_be_off ? engine::Severity::kMedium : engine::Severity::kHigh,
             absl::StrCat("blind: ", absl::StrJoin(due, "; "), "; rules lower no level of ",
                          config_.id, " meanwhile"));
  }
  // A sensor that is away says nothing, not that it sees.
  const auto primary = sensors_.find(config_.primary_sensor);
  const bool all_say = primary != sensors_.end() && primary->second.settled &&
                       std::all_of(sensors_.begin(), sensors_.end(), [](const auto& sensor) {
                         return sensor.second.session.has_value();
                       });
  if (all_say && sight_.blind.empty() && sight_.blind_alarm.Over()) {
    OwnAlert(engine::Severity::kInfo, absl::StrCat(config_.id, " is seen again"));
  }
}

}  // namespace rips::pipeline
