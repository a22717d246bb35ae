// The sensors of one robot: their sessions, how far their observations are judged, the graph that
// each has reported, their interest and their credit. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SENSOR_SIDE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SENSOR_SIDE_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "policy_server/server/robot/context/alerts.h"
#include "policy_server/server/robot/context/context.h"
#include "policy_server/server/robot/context/evidence_gate.h"
#include "policy_server/server/robot/context/own_agents.h"
#include "policy_server/server/robot/model/coverage.h"
#include "policy_server/server/robot/sensors/losses.h"
#include "policy_server/server/robot/sensors/sensor_host.h"
#include "policy_server/server/store/records.h"

namespace rips::pipeline {

// Not thread-safe. All that it is given outlives it.
class SensorSide {
 public:
  // `record`: up to where the store has judged.
  SensorSide(Context* context, Alerts* alerts, EvidenceGate* evidence, OwnAgents* own_agents,
             Losses* losses, const store::RobotRecord& record);

  // ---- sessions
  // True: a session began. Else it was closed: the host is not listed, or has a live session.
  bool OnHello(const input::SensorHello& in);
  void OnHeartbeat(const input::SensorHeartbeat& in);
  void OnInterestAnswer(const input::InterestAnswer& in);
  void OnInterestSent(const input::InterestSent& in);
  // Null unless the session is the host's. The session lives, since something came of it.
  SensorHost* Hear(const std::string& host, SessionId session);
  SensorHost* Find(const std::string& host, SessionId session);
  // Null if the inventory does not list it.
  SensorHost* Listed(const std::string& host);
  // Its stream has ended.
  void OnGone(const std::string& host, SessionId session);
  void Close(SensorHost& host, const absl::Status& why);
  // The next stream starts with a snapshot.
  void RefuseGraph(SensorHost& host, const absl::Status& why);
  // Closes sessions that are silent for too long, and reports hosts without one.
  void CheckLost();
  void CloseAll(const absl::Status& why);
  // `next`: the hosts and the primary sensor from now on. Sessions of others are closed.
  void SetHosts(const RobotConfig& next);

  // ---- what sensors are sent
  void SendSetups();
  // That one is to tell again all findings that stand.
  void AskFindings(const std::string& host);
  void EchoHeartbeats();
  // The policy in force, or the one that runs muted, has changed.
  void AskInterest();
  void GrantCredit(SensorHost& host);
  // All up to `judged` is durable, as of context.store.
  void Acknowledge(const store::HighWater& judged);

  // True if the sensor is overloaded and was not before. `boottime_ns` is the sensor's.
  bool OnState(SensorHost& host, SensorStateSeen state, int64_t boottime_ns);

  // ---- what is known of them
  const SensorHosts& hosts() const { return hosts_; }
  SensorHost* primary() { return Listed(context_.config.primary_sensor); }
  // As OwnAgents::DoubtOf.
  std::string DoubtOf(const SensorHost& host) const;
  // What keeps evidence from being complete.
  void AddProblems(std::vector<std::string>& problems) const;
  bool HasBacklog() const;
  // All have a session that is heard, a settled graph if primary, and no backlog.
  bool complete() const;
  // All have a session that is heard.
  bool connected() const;
  // Why the primary sensor does not watch what the rules need; empty = it does.
  std::string InterestProblem(const SensorHost& host) const;
  void AddHighWater(store::HighWater& judged) const;

 private:
  // It has a session that is heard.
  bool Connected(const SensorHost& host) const;
  bool IsPrimary(const SensorHost& host) const {
    return host.name == context_.config.primary_sensor;
  }
  void SendSetup(SensorHost& host, bool want_findings = false);
  void SendInterest(SensorHost& host);
  void OnRestart(SensorHost& host, const SensorHello& hello);

  Context& context_;
  Alerts& alerts_;
  EvidenceGate& evidence_;
  OwnAgents& own_agents_;
  Losses& losses_;
  SensorHosts hosts_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SENSOR_SIDE_H_
