// Robot: the inventory changes while the server runs.
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/robot.h"

namespace rips::pipeline {
namespace {

bool Lists(const std::vector<std::string>& hosts, const std::string& host) {
  return std::find(hosts.begin(), hosts.end(), host) != hosts.end();
}

absl::Status NotListed(absl::string_view agent, const std::string& host, const std::string& robot) {
  return absl::PermissionDeniedError(absl::StrCat("the inventory no longer lists ", agent, " `",
                                                  host, "` of robot `", robot, "`"));
}

}  // namespace

void Robot::SetHosts(const RobotConfig& config) {
  const Instant now = ports_.clock->Now();
  SetSensors(config, now);
  config_ = config;
  SetActuators(config, now);
  TellMissingPrograms();
  // Nothing was seen or held by those who are new.
  evidence_.Disturb("the inventory lists other hosts", now);
  UpdateActuation(now);
  SendCommands(now);
  Flush();
  PublishStatus();
}

// A primary sensor that becomes another, or was another, starts its session anew: what it has to
// report differs.
void Robot::SetSensors(const RobotConfig& config, Instant now) {
  for (auto it = sensors_.begin(); it != sensors_.end();) {
    auto& [name, host] = *it;
    const bool listed = Lists(config.sensor_hosts, name);
    const bool part_changed =
        (name == config.primary_sensor) != (name == config_.primary_sensor) ||
        (name == config.primary_sensor && config.graph_limits != config_.graph_limits);
    if (host.session && (!listed || part_changed)) {
      host.session->link->Close(listed ? absl::AbortedError("its part in the inventory has changed")
                                       : NotListed("sensor", name, config_.id));
      host.session.reset();
      host.gone_since_ns = now.boottime_ns;
    }
    if (part_changed) host.BeginGraph(config.graph_limits, kept_topics_);
    it = listed ? std::next(it) : sensors_.erase(it);
  }
  for (const std::string& name : config.sensor_hosts) {
    const auto [it, fresh] = sensors_.try_emplace(name);
    if (!fresh) continue;
    it->second.name = name;
    it->second.BeginGraph(config.graph_limits, kept_topics_);
    it->second.gone_since_ns = now.boottime_ns;
  }
}

void Robot::SetActuators(const RobotConfig& config, Instant now) {
  for (auto it = actuators_.begin(); it != actuators_.end();) {
    auto& [name, host] = *it;
    if (Lists(config.actuator_hosts, name)) {
      ++it;
      continue;
    }
    if (host.session) host.session->link->Close(NotListed("actuator", name, config_.id));
    if (host.arming) host.arming->Close(NotListed("actuator", name, config_.id));
    if (drill_) drill_->run.OnGone(name);
    it = actuators_.erase(it);
  }
  for (const std::string& name : config.actuator_hosts) {
    const auto [it, fresh] = actuators_.try_emplace(name);
    if (fresh) it->second.gone_since_ns = now.boottime_ns;
  }
  ledger_.SetHosts(config.actuator_hosts);
  SendSetups();
}

void Robot::SetPolicyProblem(std::string problem) {
  policy_problem_ = std::move(problem);
  PublishStatus();
}

void Robot::Retire(const absl::Status& why) {
  retired_ = true;
  for (auto& [name, host] : sensors_) {
    if (host.session) host.session->link->Close(why);
    host.session.reset();
  }
  for (auto& [name, host] : actuators_) {
    if (host.session) host.session->link->Close(why);
    host.session.reset();
    if (host.arming) host.arming->Close(why);
    host.arming.reset();
  }
  control_line_.batches.clear();
  message_line_.batches.clear();
  message_line_.unfinished = false;
  taps_.clear();
  if (drill_) {
    std::exchange(drill_, std::nullopt)->reply({.status = why, .drills = {}});
  }
  orders_.RefuseAll(why);
  outbox_.TouchSequences();
  Flush();
}

bool Robot::gone() const { return retired_ && outbox_.done(); }

}  // namespace rips::pipeline
