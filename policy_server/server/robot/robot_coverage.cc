// Robot: what is seen of it, and what its sensors are asked for.
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/interest/kept_topics.h"
#include "policy_server/server/robot/robot.h"
#include "services/base/payload_limits.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {

std::shared_ptr<const engine::InterestPlan> MakeInterest(const engine::CompiledPolicy& program) {
  return std::make_shared<const engine::InterestPlan>(
      engine::PlanInterest(program.rules(), kPayloadBytesDefault));
}

std::shared_ptr<const ros2::TopicNames> MakeKeptTopics(const engine::CompiledPolicy& program) {
  return std::make_shared<const ros2::TopicNames>(engine::KeptTopics(program.rules()));
}

void Robot::UseInterest() {
  interest_ = policy_.interest != nullptr ? policy_.interest : MakeInterest(*policy_.program);
  kept_topics_ =
      policy_.kept_topics != nullptr ? policy_.kept_topics : MakeKeptTopics(*policy_.program);
  for (auto& [name, host] : sensors_) host.graph.SetKeptTopics(kept_topics_);
  const auto primary = sensors_.find(config_.primary_sensor);
  if (primary == sensors_.end() || !primary->second.session) return;
  if (!AskInterest(*primary->second.session)) return;
  // Until the sensor has it in use, it may leave out what the new rules need.
  evidence_.Disturb("the sensors are asked to watch something else", ports_.clock->Now());
}

bool Robot::AskInterest(SensorSession& session) {
  std::string id = session.link->SetInterest(*interest_, policy_.payload_limits, *kept_topics_);
  if (id == session.interest_wanted) return false;
  session.interest_wanted = std::move(id);
  session.interest_problem.clear();
  return true;
}

void Robot::OnInterestAnswer(const std::string& host, const SensorLink* link,
                             const InterestAnswer& answer) {
  SensorSession* session = HearSensor(host, link);
  if (session == nullptr) return;
  if (answer.problem.empty()) {
    session->interest_in_use = answer.id;
    if (answer.id == session->interest_wanted) session->interest_problem.clear();
  } else if (answer.id == session->interest_wanted && answer.id != session->interest_in_use) {
    // Whoever repeats it is not heard again.
    if (!session->interest_problem.empty()) return;
    session->interest_problem = ros2::Printable(answer.problem);
    OwnAlert(engine::Severity::kHigh, InterestProblem(sensors_[host]));
    Flush();
  }
  UpdateEvidence(ports_.clock->Now());
  PublishStatus();
}

std::string Robot::InterestProblem(const SensorHost& host) const {
  if (host.name != config_.primary_sensor || !host.session) return "";
  const SensorSession& session = *host.session;
  if (session.interest_in_use == session.interest_wanted) return "";
  if (session.interest_problem.empty()) {
    return absl::StrCat("sensor ", host.name, " does not watch yet what the rules need");
  }
  return absl::StrCat("sensor ", host.name,
                      " does not watch what the rules need: ", session.interest_problem);
}

std::vector<SensorInterest> Robot::SensorInterests() const {
  std::vector<SensorInterest> out;
  const auto primary = sensors_.find(config_.primary_sensor);
  if (primary == sensors_.end()) return out;
  SensorInterest& one = out.emplace_back(SensorInterest{.host = primary->first});
  if (!primary->second.session) return out;
  const SensorSession& session = *primary->second.session;
  one.connected = true;
  one.in_use = session.interest_in_use == session.interest_wanted;
  if (!one.in_use) one.problem = session.interest_problem;
  return out;
}

void Robot::OnSensorHeartbeat(const std::string& host, const SensorLink* link,
                              const SensorHeartbeat& heartbeat) {
  SensorSession* session = HearSensor(host, link);
  if (session == nullptr) return;
  session->peer_boottime_ns = heartbeat.clock.boottime_ns;
  TellSecond("sensor", host, sensors_[host].second);
  if (!session->skew.Heartbeat(heartbeat, ports_.clock->Now())) return;
  OwnAlert(engine::Severity::kMedium,
           absl::StrCat("the wall clock of sensor ", host, " is off by about ",
                        *session->skew.estimate_ns() / kNanosPerMilli, " ms"));
  External(engine::AgentEvent{.agent = "sensor", .state = "clock_skew"});
}

void Robot::TakeHello(SensorHost& host, const SensorHello& hello, Instant now) {
  if (host.restarts.Began(hello.incarnation, now.boottime_ns)) {
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat("sensor ", host.name, " has restarted ", RestartCount::kRestartsMax,
                          " times within ten minutes"));
    External(engine::AgentEvent{.agent = "sensor", .state = "restarting"});
  }
  host.state = {.not_visible = hello.not_visible, .blind = hello.blind};
  host.state_boottime_ns = hello.clock.boottime_ns;
  UpdateBlind(now);
  coverage_alarm_.SetKinds(host.name, hello.not_visible);
  if (hello.participant.none()) return;
  host.graph.SetObserver(hello.participant);
  TakeParticipant(absl::StrCat("sensor ", host.name), hello.participant, host.participants);
  for (auto& [name, other] : sensors_) {
    if (&other != &host && other.session) SendSetup(name, other, *other.session);
  }
}

bool Robot::TakeState(SensorHost& host, SensorStateSeen state, int64_t boottime_ns) {
  const Instant now = ports_.clock->Now();
  if (boottime_ns < host.state_boottime_ns) {
    // Of the backlog: what the sensor sees was said anew since then.
    state.not_visible = host.state.not_visible;
    state.blind = host.state.blind;
  } else {
    host.state_boottime_ns = boottime_ns;
  }
  const bool overloaded = state.overloaded;
  const bool was_overloaded = std::exchange(host.state, std::move(state)).overloaded;
  coverage_alarm_.SetKinds(host.name, host.state.not_visible);
  UpdateBlind(now);
  UpdateEvidence(now);
  if (!overloaded) return false;
  evidence_.Disturb("the sensor is overloaded", now);
  return !was_overloaded;
}

void Robot::CountLost(SensorHost& host, uint64_t count) {
  if (count == 0) return;
  if (ports_.counts.observations_lost) ports_.counts.observations_lost(count);
  host.losses.Add(count, ports_.clock->Now().boottime_ns);
}

void Robot::UpdateCoverage(Instant now) {
  std::vector<ros2::Guid> own = Participants();
  if (sight_.counted_revision != state_.graph.revision() || sight_.counted_without != own) {
    sight_.counted_revision = state_.graph.revision();
    sight_.counted_without = std::move(own);
    const EndpointCounts counts = CountEndpoints(graph(), sight_.counted_without);
    coverage_alarm_.SetNotVisible(counts.not_visible);
    if (ports_.counts.endpoints) ports_.counts.endpoints(config_.id, counts);
  }
  for (const auto& [name, host] : sensors_) {
    if (!host.session || !ports_.counts.clock_skew) continue;
    const std::optional<int64_t> skew_ns = host.session->skew.estimate_ns();
    if (skew_ns.has_value()) ports_.counts.clock_skew(config_.id, name, *skew_ns);
  }
  if (const auto fallen = coverage_alarm_.Due(now.boottime_ns)) {
    OwnAlert(engine::Severity::kMedium, absl::StrCat("less is seen: ", *fallen));
  }
}

void Robot::CountCut(const MessageSeen& message) {
  // Without any payload it was not asked for, or shed: then it was not cut.
  if (!message.truncated || message.payload.empty()) return;
  if (ports_.counts.payloads_cut) ports_.counts.payloads_cut(1);
  sight_.cut_payloads.Add(message.topic, static_cast<uint32_t>(message.payload.size()),
                          message.size_bytes, ports_.clock->Now().boottime_ns);
}

std::vector<CutPayloads::Topic> Robot::CutTopics() const {
  return sight_.cut_payloads.Recent(ports_.clock->Now().boottime_ns);
}

std::vector<SensorCoverage> Robot::Coverage() const {
  const Instant now = ports_.clock->Now();
  std::vector<SensorCoverage> out;
  for (const auto& [name, host] : sensors_) {
    SensorCoverage& one =
        out.emplace_back(SensorCoverage{.host = name,
                                        .primary = name == config_.primary_sensor,
                                        .connected = host.session.has_value(),
                                        .state = host.state,
                                        .lost = host.losses.Total(now.boottime_ns)});
    if (!host.session) continue;
    // A sensor that reports no graph has nothing to settle.
    one.settled = !one.primary || host.settled;
    one.clock_skew_ns = host.session->skew.estimate_ns();
  }
  return out;
}

}  // namespace rips::pipeline
