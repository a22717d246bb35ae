#include "policy_server/server/fleet_metrics.h"

#include <algorithm>
#include <filesystem>
#include <system_error>
#include <utility>

#include "absl/strings/string_view.h"

namespace rips::server {
namespace {

constexpr char kSensor[] = "sensor";
constexpr char kActuator[] = "actuator";
// In the order of pipeline::Queue.
constexpr const char* kQueues[] = {"orders", "actuators", "control", "messages"};
static_assert(std::size(kQueues) == pipeline::kQueueCount);

const std::string* Find(const MetricLabels& labels, const char* name) {
  const auto found = labels.find(name);
  return found == labels.end() ? nullptr : &found->second;
}

double SecondsOf(int64_t ns) { return static_cast<double>(ns) / kNanosPerSecond; }

// A name in a table of levels; nullopt for one that is not there.
std::optional<size_t> IndexOf(const std::vector<std::string>& levels, const std::string& level) {
  const auto found = std::find(levels.begin(), levels.end(), level);
  if (found == levels.end()) return std::nullopt;
  return static_cast<size_t>(found - levels.begin());
}

}  // namespace

bool IsShown(const FleetMetrics::Listed& listed, const MetricLabels& labels) {
  const std::string* whose = Find(labels, "whose");
  const std::string* role = Find(labels, "role");
  const std::string* name = Find(labels, "name");
  if (whose != nullptr && role != nullptr && name != nullptr) {
    if (*whose != "peer" || (*role != kSensor && *role != kActuator)) return true;
    const size_t slash = name->find('/');
    const auto robot = listed.find(name->substr(0, slash));
    if (robot == listed.end() || slash == std::string::npos) return false;
    const auto& hosts = *role == kSensor ? robot->second.sensors : robot->second.actuators;
    return hosts.contains(name->substr(slash + 1));
  }
  const std::string* robot = Find(labels, "robot");
  if (robot == nullptr) return true;
  const auto found = listed.find(*robot);
  if (found == listed.end()) return false;
  const std::string* host = Find(labels, "host");
  return host == nullptr || found->second.sensors.contains(*host) ||
         found->second.actuators.contains(*host);
}

struct FleetMetrics::Answer {
  Mutex mu;
  std::optional<Facts> facts ABSL_GUARDED_BY(mu);
};

struct FleetMetrics::Tables {
  explicit Tables(Metrics* metrics) {
    const auto table = [metrics](const char* name, const char* help) {
      return metrics->AddTable(name, help);
    };
    level = table("rips_robot_level", "1 for the level in force.");
    level_index = table("rips_robot_level_index",
                        "Place of the level in force in its policy; 0 = the least restrictive.");
    effective_index = table("rips_robot_effective_level_index",
                            "As rips_robot_level_index, of the most restrictive level that an "
                            "actuator reports; absent while none is attached.");
    stage = table("rips_robot_stage", "1 for how far the newest level decision has come.");
    bundle = table("rips_robot_bundle_info", "1 for the bundle in force.");
    judged = table("rips_robot_judged", "1 = a policy judges the robot; 0 = nothing does.");
    degraded = table("rips_robot_degraded", "Problems in the robot's status; 0 = none.");
    policy_problem = table("rips_robot_policy_problem",
                           "1 = the robot is not judged by the bundle that it should be.");
    approvals = table("rips_robot_approvals_waiting",
                      "Lowerings of the level that wait for a second operator.");
    maintenance = table("rips_robot_maintenance",
                        "1 = the robot is in maintenance: its agents may be away; 0 = it is not.");
    listed = table("rips_robot_agents_listed", "Agents of the robot in the inventory.");
    connected = table("rips_robot_agents_connected", "Of these, agents with a session.");
    age = table("rips_robot_status_age_seconds", "Since the robot's thread told its status.");
    tasks = table("rips_robot_tasks_waiting", "Tasks that wait for the robot's thread.");
    certificate = table("rips_robot_certificate_expiry_seconds",
                        "Seconds until the first certificate of the robot's agents expires; "
                        "negative when it has.");
    shadow = table("rips_robot_shadow_info",
                   "1 = a bundle runs muted beside the one in force; 0 = it has stopped.");
    streams = table("rips_streams_open", "Streams that are open, by what is at the other end.");
    orders = table("rips_bundle_orders_waiting", "Orders about bundles, and pushes, that wait.");
    store_bytes = table("rips_store_bytes", "Size of the store's files.");
    store_waiting = metrics->AddGauge("rips_store_batches_waiting", "Writes that wait to be made.");
    store_refused = metrics->AddCounter("rips_store_refused_total",
                                        "Writes refused because too many waited to be made.");
  }
  GaugeTable level, level_index, effective_index, stage, bundle, judged, degraded, policy_problem;
  GaugeTable approvals, maintenance, listed, connected, age, tasks, certificate, shadow;
  GaugeTable streams, orders, store_bytes;
  Gauge store_waiting;
  Counter store_refused;
};

FleetMetrics::FleetMetrics(pipeline::Pipeline* pipeline, const Clock* clock, Metrics* metrics)
    : pipeline_(pipeline),
      clock_(clock),
      metrics_(metrics),
      tables_(std::make_shared<Tables>(metrics)) {}

void FleetMetrics::SetInventory(const bundle::Inventory& inventory) {
  auto listed = std::make_shared<Listed>();
  for (const bundle::InventoryRobot& robot : inventory.robots) {
    Hosts& hosts = (*listed)[robot.id];
    for (const bundle::InventorySensor& sensor : robot.sensors) hosts.sensors.insert(sensor.host);
    hosts.actuators.insert(robot.actuators.begin(), robot.actuators.end());
  }
  metrics_->SetShown([listed](const MetricLabels& labels) { return IsShown(*listed, labels); });
  MutexLock lock(&mu_);
  listed_ = std::move(listed);
}

void FleetMetrics::Start(FleetMetricsSources sources, absl::Duration interval) {
  sources_ = std::move(sources);
  if (interval == absl::InfiniteDuration()) return;
  ticker_.emplace(absl::ZeroDuration(), [this, interval] {
    Look();
    return interval;
  });
}

void FleetMetrics::Look() {
  std::shared_ptr<const Listed> listed;
  {
    MutexLock lock(&mu_);
    listed = listed_;
  }
  const AllFacts facts = Collect(*listed);
  ShowLevels(facts);
  ShowStates(facts, *listed);
  ShowQueues(*listed);
  ShowCertificates(*listed);
  ShowShadows(*listed);
  ShowServer();
  Ask(*listed);
}

// ------------------------------------------------------------------------------------ robots

void FleetMetrics::Ask(const Listed& listed) {
  for (const auto& [robot, hosts] : listed) {
    Asked& asked = asked_[robot];
    // A robot whose thread does not come to it is not asked again.
    if (!asked.task.expired()) continue;
    if (asked.answer == nullptr) asked.answer = std::make_shared<Answer>();
    const auto held_by_task = std::make_shared<int>();
    asked.task = held_by_task;
    pipeline_
        ->Post(robot, pipeline::Queue::kOrders,
               [answer = asked.answer, clock = clock_, held_by_task](pipeline::Robot& each) {
                 const pipeline::RobotCore& core = each.core();
                 Facts facts{.status = core.Status(),
                             .levels = core.levels().names(),
                             .actuators = core.actuators().attached().size(),
                             .at_ns = clock->Now().boottime_ns};
                 for (const auto& sensor : core.sight().Coverage())
                   facts.sensors += sensor.connected;
                 MutexLock lock(&answer->mu);
                 answer->facts = std::move(facts);
               })
        .IgnoreError();  // held, or leaving; if too much waits, its age shows it
  }
}

FleetMetrics::AllFacts FleetMetrics::Collect(const Listed& listed) {
  std::erase_if(asked_, [&](const auto& entry) { return !listed.contains(entry.first); });
  AllFacts facts;
  for (const pipeline::RobotStatus& held : pipeline_->held()) {
    if (!listed.contains(held.robot)) continue;
    // What it said before it was held is over.
    asked_.erase(held.robot);
    facts[held.robot] = {.status = held, .at_ns = clock_->Now().boottime_ns};
  }
  for (const auto& [robot, asked] : asked_) {
    MutexLock lock(&asked.answer->mu);
    if (asked.answer->facts) facts[robot] = *asked.answer->facts;
  }
  return facts;
}

void FleetMetrics::ShowLevels(const AllFacts& facts) const {
  std::vector<MetricSample> level, index, effective, stage, bundle;
  for (const auto& [robot, each] : facts) {
    const pipeline::RobotStatus& status = each.status;
    const auto add = [&robot = robot](std::vector<MetricSample>& samples, const char* label,
                                      const std::string& value) {
      if (!value.empty()) samples.push_back({{{"robot", robot}, {label, value}}, 1});
    };
    const auto add_index = [&](std::vector<MetricSample>& samples, const std::string& name) {
      if (const auto at = IndexOf(each.levels, name)) {
        samples.push_back({{{"robot", robot}}, static_cast<double>(*at)});
      }
    };
    add(level, "level", status.decided_level);
    add(stage, "stage", status.stage);
    add(bundle, "bundle", status.bundle_version);
    add_index(index, status.decided_level);
    add_index(effective, status.effective_level);
  }
  tables_->level.Replace(std::move(level));
  tables_->level_index.Replace(std::move(index));
  tables_->effective_index.Replace(std::move(effective));
  tables_->stage.Replace(std::move(stage));
  tables_->bundle.Replace(std::move(bundle));
}

void FleetMetrics::ShowStates(const AllFacts& facts, const Listed& listed) const {
  std::vector<MetricSample> judged, degraded, problem, approvals, maintenance, age, connected,
      agents;
  const int64_t now_ns = clock_->Now().boottime_ns;
  for (const auto& [robot, each] : facts) {
    const auto add = [&robot = robot](std::vector<MetricSample>& samples, double value) {
      samples.push_back({{{"robot", robot}}, value});
    };
    add(judged, each.levels.empty() ? 0 : 1);
    add(degraded, static_cast<double>(each.status.degraded.size()));
    add(problem, each.status.policy_problem.empty() ? 0 : 1);
    add(approvals, static_cast<double>(each.status.pending_approvals.size()));
    add(maintenance, each.status.maintenance ? 1 : 0);
    add(age, SecondsOf(now_ns - each.at_ns));
    const auto add_agents = [&robot = robot](std::vector<MetricSample>& samples, size_t sensors,
                                             size_t actuators) {
      samples.push_back({{{"robot", robot}, {"agent", kSensor}}, static_cast<double>(sensors)});
      samples.push_back({{{"robot", robot}, {"agent", kActuator}}, static_cast<double>(actuators)});
    };
    const Hosts& hosts = listed.at(robot);
    add_agents(agents, hosts.sensors.size(), hosts.actuators.size());
    // A robot that is held has no sessions, whatever its agents do.
    if (!each.levels.empty()) add_agents(connected, each.sensors, each.actuators);
  }
  tables_->judged.Replace(std::move(judged));
  tables_->degraded.Replace(std::move(degraded));
  tables_->policy_problem.Replace(std::move(problem));
  tables_->approvals.Replace(std::move(approvals));
  tables_->maintenance.Replace(std::move(maintenance));
  tables_->age.Replace(std::move(age));
  tables_->listed.Replace(std::move(agents));
  tables_->connected.Replace(std::move(connected));
}

void FleetMetrics::ShowQueues(const Listed& listed) const {
  std::vector<MetricSample> tasks;
  for (const auto& [robot, counts] : pipeline_->waiting()) {
    if (!listed.contains(robot)) continue;
    for (size_t i = 0; i < counts.size(); ++i) {
      tasks.push_back({{{"robot", robot}, {"queue", kQueues[i]}}, static_cast<double>(counts[i])});
    }
  }
  tables_->tasks.Replace(std::move(tasks));
}

void FleetMetrics::ShowCertificates(const Listed& listed) const {
  if (sources_.certificates == nullptr) return;
  // By robot and role: the first to expire.
  std::map<std::pair<std::string, std::string>, absl::Time> ends;
  for (const rpc::Peer& peer : sources_.certificates->peers()) {
    const rpc::PeerIdentity& of = peer.identity;
    if (of.role != rpc::Role::kSensor && of.role != rpc::Role::kActuator) continue;
    const auto robot = listed.find(of.robot);
    if (robot == listed.end()) continue;
    const bool sensor = of.role == rpc::Role::kSensor;
    const auto& hosts = sensor ? robot->second.sensors : robot->second.actuators;
    if (!hosts.contains(of.host)) continue;
    absl::Time& end =
        ends.try_emplace({of.robot, sensor ? kSensor : kActuator}, peer.not_after).first->second;
    end = std::min(end, peer.not_after);
  }
  const absl::Time now = absl::FromUnixNanos(clock_->Now().unix_ns);
  std::vector<MetricSample> left;
  for (const auto& [key, end] : ends) {
    left.push_back(
        {{{"robot", key.first}, {"agent", key.second}}, absl::ToDoubleSeconds(end - now)});
  }
  tables_->certificate.Replace(std::move(left));
}

void FleetMetrics::ShowShadows(const Listed& listed) const {
  if (sources_.shadows == nullptr) return;
  std::vector<MetricSample> shadows;
  for (const auto& [robot, report] : sources_.shadows->Reports()) {
    if (!listed.contains(robot)) continue;
    shadows.push_back(
        {{{"robot", robot}, {"bundle", report.bundle_id}}, report.problem.empty() ? 1.0 : 0.0});
  }
  tables_->shadow.Replace(std::move(shadows));
}

// ------------------------------------------------------------------------------------ server

void FleetMetrics::ShowServer() {
  if (sources_.sessions != nullptr) {
    const std::map<rpc::Role, size_t> open = sources_.sessions->Open();
    std::vector<MetricSample> streams;
    for (const rpc::Role role : {rpc::Role::kSensor, rpc::Role::kActuator, rpc::Role::kOperator}) {
      const auto found = open.find(role);
      streams.push_back({{{"agent", std::string(rpc::RoleName(role))}},
                         found == open.end() ? 0.0 : static_cast<double>(found->second)});
    }
    tables_->streams.Replace(std::move(streams));
  }
  if (sources_.orders != nullptr && sources_.pushes != nullptr) {
    tables_->orders.Replace(
        {{{{"queue", "orders"}}, static_cast<double>(sources_.orders->waiting())},
         {{{"queue", "pushes"}}, static_cast<double>(sources_.pushes->waiting())}});
  }
  if (sources_.committer != nullptr) {
    tables_->store_waiting.Set(static_cast<double>(sources_.committer->waiting()));
    const uint64_t refused = sources_.committer->refused();
    tables_->store_refused.Increment(
        static_cast<double>(refused - std::exchange(refused_, refused)));
  }
  if (sources_.store_path.empty()) return;
  std::vector<MetricSample> bytes;
  for (const auto& [file, suffix] : {std::pair("database", ""), std::pair("log", "-wal")}) {
    std::error_code failed;
    const auto size = std::filesystem::file_size(sources_.store_path + suffix, failed);
    if (!failed) bytes.push_back({{{"file", file}}, static_cast<double>(size)});
  }
  tables_->store_bytes.Replace(std::move(bytes));
}

}  // namespace rips::server
