#include "policy_server/server/fleet.h"

#include <algorithm>
#include <set>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/bundle/inventory_files.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::server {
namespace {

pipeline::RobotConfig ToConfig(const bundle::InventoryRobot& robot) {
  pipeline::RobotConfig config{.id = robot.id,
                               .actuator_hosts = robot.actuators,
                               .graph_limits = robot.graph_limits,
                               .sensor_settings = robot.sensor_settings};
  for (const bundle::InventorySensor& sensor : robot.sensors) {
    config.sensor_hosts.push_back(sensor.host);
    if (sensor.primary) config.primary_sensor = sensor.host;
  }
  return config;
}

bool IsOf(const std::set<std::string>* only, const std::string& robot) {
  return only == nullptr || only->contains(robot);
}

// As an operator knows it.
std::string Described(const std::string& name, const std::string& id) {
  return id.empty() ? absl::StrCat("bundle `", name, "`")
                    : absl::StrCat("bundle `", name, "`, activated as ", id.substr(0, 19), ",");
}

bool SameHosts(const bundle::InventoryRobot& a, const bundle::InventoryRobot& b) {
  return a.sensors == b.sensors && a.actuators == b.actuators && a.graph_limits == b.graph_limits &&
         a.sensor_settings == b.sensor_settings;
}

// Robots of both inventories whose sensors are to follow other settings.
std::vector<std::string> WithOtherSettings(const bundle::Inventory& before,
                                           const bundle::Inventory& now) {
  std::vector<std::string> robots;
  for (const bundle::InventoryRobot& robot : now.robots) {
    const bundle::InventoryRobot* old = before.Find(robot.id);
    if (old != nullptr && old->sensor_settings != robot.sensor_settings) robots.push_back(robot.id);
  }
  return robots;
}

// One line of what may be a page of diagnostics: the whole is in the log.
std::string FirstLine(absl::string_view text) {
  return std::string(text.substr(0, text.find('\n')));
}

}  // namespace

std::vector<pipeline::AgentId> AgentsOf(const bundle::Inventory& inventory) {
  std::vector<pipeline::AgentId> agents;
  for (const bundle::InventoryRobot& robot : inventory.robots) {
    for (const bundle::InventorySensor& sensor : robot.sensors) {
      agents.push_back({robot.id, pipeline::AgentKind::kSensor, sensor.host});
    }
    for (const std::string& host : robot.actuators) {
      agents.push_back({robot.id, pipeline::AgentKind::kActuator, host});
    }
  }
  return agents;
}

pipeline::RobotLabels::Labels LabelsOf(const bundle::Inventory& inventory) {
  pipeline::RobotLabels::Labels labels;
  for (const bundle::InventoryRobot& robot : inventory.robots) {
    for (const auto& [key, value] : robot.labels) {
      labels[robot.id].insert(absl::StrCat(key, "=", value));
    }
  }
  return labels;
}

Fleet::Fleet(FleetOptions options, store::Store* store, pipeline::Pipeline* pipeline,
             pipeline::ServerAlerts* alerts, PolicySource* policies, pipeline::Ports ports,
             FleetCounts counts)
    : options_(std::move(options)),
      store_(store),
      pipeline_(pipeline),
      alerts_(alerts),
      policies_(policies),
      ports_(std::move(ports)),
      counts_(std::move(counts)) {
  ports_.fenced = [this](const std::string& robot, const absl::Status& why) {
    OnFenced(robot, why);
  };
  ports_.on_status = [alerts](const pipeline::RobotStatus& status) {
    alerts->SetMaintenance(status.robot, status.maintenance);
  };
}

absl::StatusOr<bundle::Inventory> Fleet::ReadInventory() const {
  RIPS_ASSIGN_OR_RETURN(bundle::InventoryFiles read, bundle::ReadInventory(options_.inventory));
  return std::move(read.inventory);
}

absl::Status Fleet::Start() {
  RIPS_ASSIGN_OR_RETURN(inventory_, ReadInventory());
  if (counts_.inventory) counts_.inventory(inventory_, /*refused=*/false);
  const PolicySource::Policies policies = policies_->FindAll(inventory_);
  std::vector<std::string> robots;
  for (const bundle::InventoryRobot& robot : inventory_.robots) robots.push_back(robot.id);
  RIPS_ASSIGN_OR_RETURN(const std::vector<store::Acquired> acquired, store_->Acquire(robots));
  for (size_t i = 0; i < robots.size(); ++i) {
    const bundle::InventoryRobot& robot = inventory_.robots[i];
    if (counts_.listed) counts_.listed(robot);
    RIPS_RETURN_IF_ERROR(Arm(robot, policies.at(policies_->SourceOf(robot)), acquired[i]));
  }
  ForgetUnused();
  Count();
  return absl::OkStatus();
}

absl::Status Fleet::Arm(const bundle::InventoryRobot& robot,
                        const absl::StatusOr<pipeline::Policy>& policy,
                        const store::Acquired& acquired) {
  const store::RobotRecord& record = acquired.record;
  const auto add = [&](const pipeline::Policy& by) {
    return pipeline_->Add(ToConfig(robot), by, options_.timing, record, acquired.tenure, ports_);
  };
  absl::Status added = policy.ok() ? add(*policy) : policy.status();
  std::string problem;
  if (!added.ok()) {
    problem = absl::StrCat(Described(robot.bundle, policies_->SourceOf(robot).second),
                           " is refused: ", FirstLine(added.message()));
    if (record.bundle.empty()) return Hold(robot, record, problem);
    const absl::StatusOr<pipeline::Policy> last_good = policies_->FindLastGood(record.bundle);
    absl::Status fits = last_good.status();
    if (fits.ok()) fits = add(*last_good);
    if (!fits.ok()) {
      return Hold(robot, record,
                  absl::StrCat(problem, "; the last good one (", record.bundle,
                               ") is refused too: ", FirstLine(fits.message())));
    }
    absl::StrAppend(&problem, "; the last good policy ", record.bundle, " is in force");
  }
  LogInfo("robot", {{"robot", robot.id},
                    {"level", record.level.empty() ? "(first start)" : record.level},
                    {"decision_id", ToString(record.decision_id)},
                    {"term", acquired.tenure}});
  SetProblem(robot.id, problem, record.level);
  return absl::OkStatus();
}

absl::Status Fleet::Hold(const bundle::InventoryRobot& robot, const store::RobotRecord& record,
                         const std::string& why) {
  const std::string level = record.level.empty() ? "(none yet)" : record.level;
  const std::string text =
      absl::StrCat("no policy: ", why, "; nothing judges `", robot.id, "`, its level ", level,
                   " stands, and its actuators take their fail-safe level when their lease ends; "
                   "mend the bundle "
                   "and send the server SIGHUP");
  RIPS_RETURN_IF_ERROR(pipeline_->Hold({.robot = robot.id,
                                        .decided_level = record.level,
                                        .decision_id = record.decision_id,
                                        .degraded = {text},
                                        .policy_problem = text},
                                       absl::FailedPreconditionError(text)));
  SetProblem(robot.id, text, record.level);
  return absl::OkStatus();
}

void Fleet::OnFenced(const std::string& robot, const absl::Status& why) {
  const std::string text =
      absl::StrCat("owned by another policy server: ", why.message(), "; this one judges `", robot,
                   "` no more and lets its leases end; to judge it here, stop the other server and "
                   "send this one SIGHUP");
  LogError("robot is owned by another policy server",
           {{"robot", robot}, {"reason", why.message()}});
  const absl::Status held = absl::FailedPreconditionError(text);
  pipeline_->Remove(robot, held).IgnoreError();
  pipeline_->Hold({.robot = robot, .degraded = {text}}, held).IgnoreError();
  alerts_->Raise(robot, engine::Severity::kCritical, text);
}

void Fleet::SetProblem(const std::string& robot, const std::string& text,
                       const std::string& level) {
  pipeline_
      ->Post(robot, pipeline::Queue::kOrders,
             [text](pipeline::Robot& each) { each.SetPolicyProblem(text); })
      .IgnoreError();  // one that is held shows it already
  if (text.empty()) {
    if (problems_.erase(robot) == 0) return;
    LogInfo("bundle is in order again", {{"robot", robot}});
    alerts_->Raise(robot, engine::Severity::kInfo,
                   "the bundle that the inventory names is in order again");
    return;
  }
  std::string& known = problems_[robot];
  if (known == text) return;
  known = text;
  LogError("robot runs without the policy named in the inventory",
           {{"robot", robot}, {"reason", text}});
  alerts_->Raise(robot, engine::Severity::kCritical, text, level);
}

// ------------------------------------------------------------------------------------- reload

void Fleet::Reload() {
  absl::StatusOr<bundle::Inventory> read = ReadInventory();
  if (read.ok() && read->robots.empty() && !inventory_.robots.empty()) {
    // An editor's empty file looks the same.
    read = absl::InvalidArgumentError(
        absl::StrCat(options_.inventory, " lists no robot; to guard none, stop the server"));
  }
  if (!read.ok()) {
    LogError("inventory rejected; keeping the previous one", {{"reason", read.status().message()}});
    alerts_->Raise(std::string(store::kServerRobot), engine::Severity::kHigh,
                   absl::StrCat("the inventory is refused, the old one stays in force until the "
                                "server is started anew, which would fail: ",
                                FirstLine(read.status().message())));
  }
  const bool taken = read.ok();
  const bundle::Inventory now = taken ? *std::move(read) : inventory_;
  if (taken) {
    LogInfo("inventory read", {{"path", options_.inventory}, {"robots", now.robots.size()}});
    for (const std::string& warning : now.warnings) {
      LogWarning("inventory", {{"warning", warning}});
    }
  }
  if (const std::vector<std::string> robots = WithOtherSettings(inventory_, now); !robots.empty()) {
    constexpr size_t kNamedMax = 20;
    const size_t named = std::min(robots.size(), kNamedMax);
    alerts_->Raise(std::string(store::kServerRobot), engine::Severity::kInfo,
                   absl::StrCat("the inventory sets other settings for sensors of ", robots.size(),
                                robots.size() == 1 ? " robot: " : " robots: ",
                                absl::StrJoin(robots.begin(),
                                              robots.begin() + static_cast<ptrdiff_t>(named), ", "),
                                named < robots.size() ? ", ..." : "",
                                "; those that follow them begin to watch anew within a minute"));
  }
  RemoveMissing(now);
  Settle(now);
  inventory_ = now;
  if (counts_.inventory) counts_.inventory(inventory_, /*refused=*/!taken);
  ForgetUnused();
  Count();
}

void Fleet::Apply(const std::set<std::string>& robots) {
  Settle(inventory_, &robots);
  Count();
}

void Fleet::Settle(const bundle::Inventory& now, const std::set<std::string>* only) {
  const PolicySource::Policies policies = policies_->FindAll(now, only);
  const std::vector<std::string> judged = pipeline_->robots();
  for (const bundle::InventoryRobot& robot : now.robots) {
    if (!IsOf(only, robot.id)) continue;
    const absl::StatusOr<pipeline::Policy>& policy = policies.at(policies_->SourceOf(robot));
    if (counts_.listed && inventory_.Find(robot.id) == nullptr) counts_.listed(robot);
    if (std::binary_search(judged.begin(), judged.end(), robot.id)) {
      Change(robot, inventory_.Find(robot.id), policy);
      continue;
    }
    absl::Status armed;
    if (!pipeline_->WaitGone(robot.id, options_.leaving)) {
      armed = Hold(robot, {}, "what it decided before it was removed is not recorded yet");
    } else {
      const absl::StatusOr<store::Acquired> acquired = store_->Acquire(robot.id);
      armed = acquired.ok() ? Arm(robot, policy, *acquired) : acquired.status();
    }
    if (armed.ok()) continue;
    LogError("robot not added", {{"robot", robot.id}, {"reason", armed.message()}});
    Hold(robot, {}, FirstLine(armed.message())).IgnoreError();
  }
}

void Fleet::RemoveMissing(const bundle::Inventory& now) {
  for (const bundle::InventoryRobot& robot : inventory_.robots) {
    if (now.Find(robot.id) != nullptr) continue;
    LogWarning("robot removed from the inventory", {{"robot", robot.id}});
    alerts_->Raise(robot.id, engine::Severity::kHigh,
                   "the robot was removed from the inventory: nothing judges it any more");
    problems_.erase(robot.id);
    const absl::Status removed =
        pipeline_->Remove(robot.id, absl::PermissionDeniedError(absl::StrCat(
                                        "robot `", robot.id, "` was removed from the inventory")));
    if (!removed.ok()) {
      LogError("robot not removed", {{"robot", robot.id}, {"reason", removed.message()}});
    }
  }
}

void Fleet::Change(const bundle::InventoryRobot& robot, const bundle::InventoryRobot* before,
                   const absl::StatusOr<pipeline::Policy>& policy) {
  absl::Status posted;
  if (before == nullptr || !SameHosts(robot, *before)) {
    const bool settings = before != nullptr && robot.sensor_settings != before->sensor_settings;
    LogInfo(settings ? "sensor settings of a robot changed" : "hosts of a robot changed",
            {{"robot", robot.id}});
    posted.Update(pipeline_->Post(
        robot.id, pipeline::Queue::kOrders,
        [config = ToConfig(robot)](pipeline::Robot& each) { each.SetHosts(config); }));
  }
  if (!policy.ok()) {
    SetProblem(robot.id,
               absl::StrCat(Described(robot.bundle, policies_->SourceOf(robot).second),
                            " is refused: ", FirstLine(policy.status().message()),
                            "; the old policy stays in force"),
               "");
  } else {
    SetProblem(robot.id, "", "");
    posted.Update(pipeline_->Post(
        robot.id, pipeline::Queue::kOrders, [policy = *policy](pipeline::Robot& each) {
          const absl::Status swapped = each.SwapPolicy(policy);
          if (swapped.ok()) return;
          LogError("bundle not taken", {{"robot", each.id()}, {"reason", swapped.message()}});
          each.SetPolicyProblem(
              absl::StrCat("bundle ", policy.bundle_id, " was not taken: ", swapped.message()));
        }));
  }
  if (!posted.ok()) {
    LogError("robot not changed", {{"robot", robot.id}, {"reason", posted.message()}});
  }
}

void Fleet::ForgetUnused() {
  std::set<std::string> in_use;
  for (const bundle::InventoryRobot& robot : inventory_.robots) {
    const absl::StatusOr<store::RobotRecord> record = store_->Load(robot.id);
    if (!record.ok()) return;  // nothing is removed that might be needed
    in_use.insert(record->bundle);
  }
  policies_->ForgetUnused(std::move(in_use));
}

void Fleet::Count() {
  if (!counts_.robots) return;
  const size_t held = pipeline_->held().size();
  const size_t troubled = problems_.size();
  counts_.robots(inventory_.robots.size() - std::max(troubled, held),
                 troubled > held ? troubled - held : 0, held);
}

std::string Fleet::Problem(const std::string& robot) const {
  const auto found = problems_.find(robot);
  return found == problems_.end() ? "" : found->second;
}

int Fleet::agents() const { return static_cast<int>(AgentsOf(inventory_).size()); }

}  // namespace rips::server
