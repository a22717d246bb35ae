#include "policy_server/server.h"

#include <algorithm>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/pooled_inspector.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::server {
namespace {

// What clients get to finish after a shutdown was announced.
constexpr absl::Duration kShutdownGrace = absl::Seconds(2);

absl::Status WithContext(absl::string_view context, const absl::Status& status) {
  if (status.ok()) return status;
  return absl::Status(status.code(), absl::StrCat(context, ": ", status.message()));
}

pipeline::Timing ToPipeline(const Timing& timing) {
  return {.heartbeat_ns = absl::ToInt64Nanoseconds(timing.heartbeat),
          .stale_ns = absl::ToInt64Nanoseconds(timing.stale),
          .lost_ns = absl::ToInt64Nanoseconds(timing.lost),
          .lease_ns = absl::ToInt64Nanoseconds(timing.lease),
          .drain_lease_ns = absl::ToInt64Nanoseconds(timing.drain_lease),
          .late_after_ns = absl::ToInt64Nanoseconds(timing.late_after),
          .tick_ns = absl::ToInt64Nanoseconds(timing.tick),
          .linger_ms = static_cast<uint32_t>(absl::ToInt64Milliseconds(timing.linger))};
}

}  // namespace

Server::Server(const ServerConfig& config) : config_(config) {}

Server::~Server() { Stop(); }

absl::StatusOr<std::unique_ptr<Server>> Server::Start(const ServerConfig& config) {
  std::unique_ptr<Server> server(new Server(config));
  RIPS_RETURN_IF_ERROR(server->Open());
  RIPS_RETURN_IF_ERROR(server->LoadPolicies());
  RIPS_RETURN_IF_ERROR(server->AddRobots());
  server->pipeline_->Start();
  RIPS_RETURN_IF_ERROR(server->Listen());
  return server;
}

absl::Status Server::Open() {
  RIPS_ASSIGN_OR_RETURN(credentials_, rpc::Credentials::Load(config_.tls));
  const rpc::PeerIdentity& self = credentials_->self();
  if (self.role != rpc::Role::kPolicyServer || self.name != config_.id ||
      self.trust_domain != config_.trust_domain) {
    return absl::InvalidArgumentError(
        absl::StrCat(config_.tls.cert, " is the certificate of ", rpc::ToString(self),
                     ", not of spiffe://", config_.trust_domain, "/policy-server/", config_.id));
  }
  RIPS_ASSIGN_OR_RETURN(const std::string text, ReadConfigFile(config_.inventory));
  RIPS_ASSIGN_OR_RETURN(inventory_, bundle::ParseInventory(config_.inventory, text));
  RIPS_ASSIGN_OR_RETURN(store_, store::SqliteStore::Open(config_.store_path));
  RIPS_ASSIGN_OR_RETURN(alert_log_, store::AlertLog::Open(config_.alerts_file));
  hub_ = std::make_unique<operator_api::Hub>(alert_log_.get());
  committer_ = std::make_unique<store::Committer>(store_.get());
  // Half the machine at most: scanning must not keep shards from judging.
  const int threads = static_cast<int>(std::thread::hardware_concurrency()) / 2;
  inspections_ = std::make_unique<inspect::InspectionPool>(
      inspect::PoolOptions{.threads = std::max(1, threads)}, &clock_);
  recorder_ = std::make_unique<pipeline::StoreRecorder>(store_.get(), committer_.get());
  return absl::OkStatus();
}

absl::StatusOr<pipeline::Policy> Server::LoadPolicy(const std::string& dir,
                                                    const std::string& name) {
  RIPS_ASSIGN_OR_RETURN(bundle::Bundle loaded, bundle::LoadBundle(dir, &clock_));
  if (loaded.manifest.name != name) {
    return absl::InvalidArgumentError(absl::StrCat("its manifest calls it `", loaded.manifest.name,
                                                   "`; the inventory wants `", name, "`"));
  }
  if (!loaded.warnings.empty()) {
    LogInfo("the rule compiler remarks", {{"bundle", dir}, {"text", loaded.warnings}});
  }
  LogInfo("bundle loaded", {{"bundle", loaded.manifest.name},
                            {"id", loaded.id},
                            {"rules", loaded.program->rules().rules.size()}});
  std::shared_ptr<pipeline::Inspector> inspector;
  if (loaded.inspections != nullptr) {
    inspector = std::make_shared<PooledInspector>(inspections_.get(), loaded.inspections);
  }
  return pipeline::Policy{.program = loaded.program,
                          .bundle_id = loaded.id,
                          .start_level = loaded.start_level,
                          .soft_hold_ns = absl::ToInt64Nanoseconds(loaded.manifest.soft_hold),
                          .inspector = std::move(inspector),
                          .interest = pipeline::MakeInterest(*loaded.program)};
}

absl::Status Server::LoadPolicies() {
  for (const bundle::InventoryRobot& robot : inventory_.robots) {
    if (policies_.contains(robot.bundle)) continue;
    const std::string dir = absl::StrCat(config_.bundles_source, "/", robot.bundle);
    absl::StatusOr<pipeline::Policy> policy = LoadPolicy(dir, robot.bundle);
    if (!policy.ok()) return WithContext(absl::StrCat("bundle ", dir), policy.status());
    policies_[robot.bundle] = *std::move(policy);
  }
  return absl::OkStatus();
}

pipeline::Counts Server::MakeCounts() {
  const auto counter = [this](const char* name, const char* help) {
    const Counter made = metrics_.AddCounter(name, help);
    return [made](uint64_t by) { made.Increment(static_cast<double>(by)); };
  };
  return {.endpoints =
              [this](const std::string& robot, const pipeline::EndpointCounts& counts) {
                const auto set = [&](const char* visibility, size_t count) {
                  metrics_
                      .AddGauge("rips_endpoints",
                                "Endpoints on the robot, by what is seen of them.",
                                {{"robot", robot}, {"visibility", visibility}})
                      .Set(static_cast<double>(count));
                };
                set("watched", counts.watched);
                set("not_needed", counts.not_needed);
                set("not_visible", counts.not_visible);
              },
          .clock_skew =
              [this](const std::string& robot, const std::string& host, int64_t ns) {
                metrics_
                    .AddGauge("rips_sensor_clock_skew_seconds",
                              "Wall clock of the sensor minus the server's, as estimated.",
                              {{"robot", robot}, {"host", host}})
                    .Set(static_cast<double>(ns) / kNanosPerSecond);
              },
          .observations_judged =
              counter("rips_observations_judged_total", "Observations judged by rules."),
          .observations_lost = counter("rips_observations_lost_total",
                                       "Observations that sensors report or show as lost."),
          .observations_duplicate = counter("rips_observations_duplicate_total",
                                            "Observations received again and not judged again."),
          .alerts = counter("rips_alerts_total", "Alerts raised."),
          .alerts_lost = counter("rips_alerts_lost_total",
                                 "Alerts dropped while the store could not be written.")};
}

absl::Status Server::AddRobots() {
  const int shards = config_.shards > 0
                         ? config_.shards
                         : static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1u,
                                                       static_cast<unsigned>(kShardsMax)));
  pipeline_ = std::make_unique<pipeline::Pipeline>(shards, &clock_);
  const pipeline::Counts counts = MakeCounts();
  for (const bundle::InventoryRobot& robot : inventory_.robots) {
    pipeline::RobotConfig config{.id = robot.id, .actuator_hosts = robot.actuators};
    for (const bundle::InventorySensor& sensor : robot.sensors) {
      config.sensor_hosts.push_back(sensor.host);
      if (sensor.primary) config.primary_sensor = sensor.host;
    }
    RIPS_ASSIGN_OR_RETURN(const store::RobotRecord record, store_->Load(robot.id));
    RIPS_ASSIGN_OR_RETURN(const uint64_t term, store_->NextTerm(robot.id));
    RIPS_RETURN_IF_ERROR(pipeline_->Add(
        std::move(config), policies_[robot.bundle], ToPipeline(config_.timing), record, term,
        {.recorder = recorder_.get(), .audience = hub_.get(), .counts = counts, .new_id = NewId}));
    LogInfo("robot", {{"robot", robot.id},
                      {"level", record.level.empty() ? "(first start)" : record.level},
                      {"mark", ToString(record.mark)},
                      {"term", term}});
  }
  return absl::OkStatus();
}

absl::Status Server::Listen() {
  const auto malformed = [this](const char* agent) {
    return metrics_.AddCounter("rips_malformed_total", "Messages of agents refused as malformed.",
                               {{"agent", agent}});
  };
  const auto streams = [this](const char* agent) {
    return metrics_.AddCounter("rips_streams_total", "Streams opened by agents.",
                               {{"agent", agent}});
  };
  watch_ = std::make_unique<rpc::SessionWatch>(&clock_);
  sensors_ = std::make_unique<ingest::SensorService>(
      pipeline_.get(), watch_.get(),
      ingest::IngestMetrics{.malformed = malformed("sensor"),
                            .streams = streams("sensor"),
                            .interests_refused = metrics_.AddCounter(
                                "rips_interests_refused_total",
                                "Lists of wanted payloads that sensors could not apply.")});
  actuators_ = std::make_unique<dispatch::ActuatorService>(
      pipeline_.get(), watch_.get(),
      dispatch::DispatchMetrics{
          .malformed = malformed("actuator"),
          .streams = streams("actuator"),
          .commands = metrics_.AddCounter("rips_commands_total", "Commands sent to actuators.")});
  operators_ =
      std::make_unique<operator_api::OperatorService>(pipeline_.get(), store_.get(), hub_.get());
  RIPS_ASSIGN_OR_RETURN(
      rpc_,
      rpc::RpcServer::Start({.listen = config_.listen, .credentials = credentials_->ForServer()},
                            {sensors_.get(), actuators_.get(), operators_.get()}));
  RIPS_ASSIGN_OR_RETURN(metrics_server_, MetricsServer::Start(config_.metrics, &metrics_,
                                                              [this] { return Readiness(); }));
  LogInfo("listening", {{"address", rpc_->address()}, {"metrics", metrics_server_->address()}});
  return absl::OkStatus();
}

absl::Status Server::Readiness() const {
  if (committer_->healthy()) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat("the store ", config_.store_path, " cannot be written"));
}

void Server::Reload() {
  if (const absl::Status status = alert_log_->Reopen(); !status.ok()) {
    LogError("alert file not reopened", {{"reason", status.message()}});
  }
  absl::btree_map<std::string, pipeline::Policy> loaded;
  for (const auto& [name, old] : policies_) {
    const std::string dir = absl::StrCat(config_.bundles_source, "/", name);
    absl::StatusOr<pipeline::Policy> policy = LoadPolicy(dir, name);
    if (policy.ok()) {
      loaded[name] = *std::move(policy);
    } else {
      LogError("bundle refused; the old one stays in force",
               {{"bundle", dir}, {"reason", policy.status().message()}});
    }
  }
  for (const bundle::InventoryRobot& robot : inventory_.robots) {
    const auto it = loaded.find(robot.bundle);
    if (it == loaded.end()) continue;
    const absl::Status posted = pipeline_->Post(
        robot.id, pipeline::Lane::kControl, [policy = it->second](pipeline::Robot& each) {
          const absl::Status swapped = each.SwapPolicy(policy);
          if (!swapped.ok()) {
            LogError("bundle not taken", {{"robot", each.id()}, {"reason", swapped.message()}});
          }
        });
    if (!posted.ok()) {
      LogError("bundle not offered", {{"robot", robot.id}, {"reason", posted.message()}});
    }
  }
  for (auto& [name, policy] : loaded) policies_[name] = std::move(policy);
}

void Server::Stop() {
  if (std::exchange(stopped_, true) || pipeline_ == nullptr) return;
  if (rpc_ != nullptr) {
    LogInfo("stopping");
    rpc_->SetServing(false);
    pipeline_->ForEach([](pipeline::Robot& robot) { robot.Drain(); });
    watch_->CloseAll(grpc::Status(grpc::StatusCode::UNAVAILABLE, "the server is stopping"));
    rpc_->Shutdown(kShutdownGrace);
  }
  // What is still being inspected is judged by whoever gets it again.
  pipeline_->Stop();
  inspections_->Stop();
  committer_->Stop();
}

}  // namespace rips::server
