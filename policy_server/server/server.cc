#include "policy_server/server/server.h"

#include <algorithm>
#include <limits>
#include <optional>
#include <span>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/bundle/bundle_keep.h"
#include "policy_server/policy/bundle/inventory_files.h"
#include "policy_server/server/audit/store_audit.h"
#include "policy_server/server/config/needed_files.h"
#include "policy_server/server/shard/agent_alerts.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/runtime/await.h"
#include "services/runtime/descriptor_limit.h"
#include "services/runtime/log.h"

namespace rips::server {
namespace {

// What clients get to finish after a shutdown was announced.
constexpr absl::Duration kShutdownGrace = absl::Seconds(2);
constexpr absl::Duration kProbePatience = absl::Seconds(1);
// Of files, plugins and what else is not a connection of an agent.
constexpr uint64_t kOtherDescriptors = 512;
// Of operators and of agents that connect anew while their old connection is not over.
constexpr int kOtherConnections = 32;
// A sensor and an actuator, each with one connection and one that is not over yet.
constexpr int kConnectionsOfAHost = 4;
// Of one operator's certificate, beside those that its streams hold: an order finds one.
constexpr int kConnectionsForCalls = 32;

constexpr absl::Duration kTimeStepMin = absl::Milliseconds(50);
constexpr absl::Duration kTimeStepMax = absl::Milliseconds(200);

// From a fast disk to what is an outage.
const std::vector<double> kCommitSeconds = {0.001, 0.003, 0.01, 0.03, 0.1, 0.3, 1, 3, 10};

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

// Ten times a heartbeat, so that nothing is late by much of one, and as often as External rules run
// when nothing happens.
int64_t TimeStepNs(const Timing& timing) {
  const absl::Duration step = std::min(timing.heartbeat / 10, timing.tick);
  return absl::ToInt64Nanoseconds(std::clamp(step, kTimeStepMin, kTimeStepMax));
}

Gauge ClockSkew(Metrics& metrics, const std::string& robot, const std::string& host) {
  return metrics.AddGauge("rips_sensor_clock_skew_seconds",
                          "Wall clock of the sensor minus the server's; NaN until estimated.",
                          {{"robot", robot}, {"host", host}});
}

Counter InspectionsSkipped(Metrics& metrics, const std::string& reason) {
  return metrics.AddCounter("rips_inspections_skipped_total",
                            "Inspections that rules needed and that were not made.",
                            {{"reason", reason}});
}

std::unique_ptr<audit::ReturnedHeads> MakeReturnedHeads(const std::string& directory,
                                                        Metrics& metrics,
                                                        pipeline::ServerAlerts* alerts) {
  std::map<audit::HeadVerdict, Counter> counters;
  for (const audit::HeadVerdict verdict : audit::kHeadVerdicts) {
    counters[verdict] = metrics.AddCounter("rips_audit_heads_total",
                                           "Heads of the audit log that actuators brought back.",
                                           {{"verdict", audit::ToString(verdict)}});
  }
  return std::make_unique<audit::ReturnedHeads>(
      std::make_unique<audit::SegmentsInDirectory>(directory),
      [alerts, counters](const audit::HeadSource& source, const model::AuditHead& head,
                         audit::HeadVerdict verdict) {
        counters.at(verdict).Increment();
        const audit::HeadAlert alert = audit::AlertOf(source, head, verdict);
        // A line, and so a limit, of its own for proof: no forged heads fold it away.
        if (verdict == audit::HeadVerdict::kContradicted) {
          alerts->Raise(source.robot, alert.severity, alert.text);
        } else if (!alert.text.empty()) {
          alerts->Raise(source.robot, alert.severity, alert.text);
        }
      });
}

}  // namespace

Server::Server(const ServerConfig& config, std::function<void()> advanced,
               std::vector<ConfigSetting> settings)
    : config_(config),
      advanced_(std::move(advanced)),
      listed_{.contacts = pipeline::AgentContacts(&clock_),
              .settings = pipeline::ListedSettings(std::move(settings))} {}

Server::~Server() { Stop(); }

absl::StatusOr<std::unique_ptr<Server>> Server::Start(const ServerConfig& config,
                                                      const Pause& pause,
                                                      std::function<void()> advanced,
                                                      std::vector<ConfigSetting> settings) {
  std::unique_ptr<Server> server(new Server(config, std::move(advanced), std::move(settings)));
  RIPS_RETURN_IF_ERROR(server->Open());
  RIPS_RETURN_IF_ERROR(server->ServePage());
  // Before the robots: their terms are drawn, and their sensors missed, only by a server that can
  // be reached.
  RIPS_RETURN_IF_ERROR(server->AwaitCredentials(pause));
  RIPS_RETURN_IF_ERROR(server->AddRobots());
  server->pipeline_->Start();
  server->bundles_->Start();
  RIPS_RETURN_IF_ERROR(server->GuardPeers());
  RIPS_RETURN_IF_ERROR(server->Listen());
  return server;
}

absl::Status Server::Open() {
  // Read again with the robots; what is malformed must not wait for certificates.
  RIPS_RETURN_IF_ERROR(bundle::ReadInventory(config_.inventory).status());
  RIPS_ASSIGN_OR_RETURN(store_, store::SqliteStore::Open(config_.store_path));
  const Counter rotation_failures = metrics_.AddCounter(
      "rips_alert_file_rotation_failures_total", "Attempts to rotate the alert file that failed.");
  RIPS_ASSIGN_OR_RETURN(
      alert_log_,
      store::AlertLog::Open(config_.alerts.path, {.rotate_bytes = config_.alerts.rotate_bytes,
                                                  .keep = config_.alerts.keep,
                                                  .on_rotation_failure = [rotation_failures] {
                                                    rotation_failures.Increment();
                                                  }}));
  const Counter file_failures = metrics_.AddCounter(
      "rips_alert_file_failures_total", "Attempts to write the alert file that failed.");
  hub_ = std::make_unique<operator_api::StatusBroadcaster>(
      store_.get(), alert_log_.get(),
      operator_api::FeedCounts{
          .file_failures =
              [file_failures](uint64_t by) { file_failures.Increment(static_cast<double>(by)); },
          .cut_traces = [cut = metrics_.AddCounter(
                             "rips_alert_traces_cut_total",
                             "Alerts whose trace leaves something out.")] { cut.Increment(); }});
  store::CommitterOptions committing;
  committing.on_commit =
      [took = metrics_.AddHistogram("rips_store_commit_seconds",
                                    "How long transactions took, those of the audit log included.",
                                    kCommitSeconds)](int64_t took_ns) {
        took.Observe(static_cast<double>(took_ns) / kNanosPerSecond);
      };
  if (config_.audit_dir.empty()) {
    LogWarning("no `audit` in the configuration: decisions are kept in the store alone");
  } else {
    const Counter failures = metrics_.AddCounter("rips_audit_failures_total",
                                                 "Writes that the audit log could not make.");
    RIPS_ASSIGN_OR_RETURN(
        audit_, audit::AuditLog::Open({.directory = config_.audit_dir,
                                       .segment_bytes = config_.audit_segment_bytes,
                                       .on_failure = [failures] { failures.Increment(); }},
                                      &clock_));
    orders_ = std::make_unique<audit::OrderAudit>(audit_.get(), &clock_);
    LogInfo("audit log opened",
            {{"dir", config_.audit_dir}, {"head", audit::FormatHead(audit_->head())}});
    committing.before_commit = [audit = std::make_shared<audit::StoreAudit>(audit_.get())](
                                   std::span<const store::WriteBatch> batches) {
      return audit->RecordBefore(batches);
    };
  }
  committer_ = std::make_unique<store::Committer>(store_.get(), std::move(committing), &clock_);
  alerts_ = std::make_unique<pipeline::ServerAlerts>(committer_.get(), hub_.get(), &clock_, NewId);
  if (audit_ != nullptr) heads_ = MakeReturnedHeads(config_.audit_dir, metrics_, alerts_.get());
  attacks_ = std::make_unique<AttackAlerts>(
      alerts_.get(), &clock_, [this](const rpc::PeerIdentity& agent, const std::string& peer) {
        pipeline::TellKeyMisused(*pipeline_, agent, peer);
      });
  store_watch_ = std::make_unique<pipeline::StoreWatch>(committer_.get(), alerts_.get(), &clock_,
                                                        config_.store_path, MakeStoreCounts());
  outputs_ = std::make_unique<outputs::Outputs>(
      config_.outputs, store_.get(), &metrics_, &clock_,
      [this](engine::Severity severity, const std::string& what) { OwnAlert(severity, what); });
  RIPS_RETURN_IF_ERROR(OpenJail());
  // Half the machine at most: scanning must not keep shards from judging. At least two, so that a
  // robot whose scans are slow leaves one to the others.
  const int threads = static_cast<int>(std::thread::hardware_concurrency()) / 2;
  inspections_ = std::make_unique<inspect::InspectionPool>(
      inspect::PoolOptions{.threads = std::max(2, threads)}, &clock_);
  recorder_ = std::make_unique<pipeline::StoreRecorder>(store_.get(), committer_.get());
  OpenRecordings();
  OpenEnrolment();
  loader_ = std::make_unique<BundleLoader>(config_.bundle_keys, &clock_, jail_.containment,
                                           inspections_.get());
  return loader_->ReadKeys();
}

void Server::OpenRecordings() {
  if (config_.recordings_bytes == 0) return;
  const auto problem = [this](const absl::Status& why) {
    OwnAlert(engine::Severity::kMedium,
             absl::StrCat("recordings of what leads to alerts are not saved: ", why.message()));
  };
  auto files = flight::FlightFiles::Open(
      {.directory = config_.recordings_directory(), .bytes_max = config_.recordings_bytes});
  if (!files.ok()) return problem(files.status());
  recordings_.files = *std::move(files);
  if (const absl::Status bad = recordings_.files->CheckWritable(); !bad.ok()) problem(bad);
  const auto recordings = [this](const char* result) {
    return metrics_.AddCounter("rips_recordings_total",
                               "Recordings of what led to alerts, by what became of them.",
                               {{"result", result}});
  };
  recordings_.archive = std::make_unique<flight::FlightArchive>(
      recordings_.files.get(),
      flight::ArchiveReports{.saved = [saved = recordings("saved")] { saved.Increment(); },
                             .failed = [failed = recordings("failed")] { failed.Increment(); },
                             .problem = problem});
}

absl::Status Server::AwaitCredentials(const Pause& pause) {
  const auto attempt = [this]() -> absl::Status {
    auto own = rpc::LoadOwn(config_.tls, [this](const rpc::PeerIdentity& self) {
      return CheckIdentity(config_, self);
    });
    if (own.ok()) credentials_ = *own;
    return own.status();
  };
  const absl::Status status = pause ? Await("a usable certificate", attempt, pause) : attempt();
  // Somebody else's.
  if (absl::IsPermissionDenied(status)) return absl::InvalidArgumentError(status.message());
  return status;
}

absl::Status Server::ServePage() {
  absl::Status taken;
  absl::StatusOr<std::unique_ptr<MetricsPage>> page = MetricsPage::Start(
      config_.metrics, &metrics_, [this] { return Readiness(); },
      [&](const absl::Status& why) { taken = why; });
  if (!page.ok()) return page.status();
  page_ = *std::move(page);
  if (!taken.ok()) OwnAlert(engine::Severity::kCritical, absl::StrCat(taken.message()));
  return absl::OkStatus();
}

void Server::OwnAlert(engine::Severity severity, const std::string& text,
                      std::source_location where) {
  alerts_->Raise(std::string(store::kServerRobot), severity, text, "", where);
}

absl::Status Server::GuardConnections() {
  const int agents = fleet_->agents();
  rpc::AdmissionLimits limits = config_.connections;
  // Each connection has two: gRPC's and the guard's.
  const uint64_t wanted = 2 * static_cast<uint64_t>(limits.total) + kOtherDescriptors;
  const uint64_t allowed = RaiseDescriptorLimit(wanted);
  const int needed = 2 * agents + kOtherConnections;
  if (limits.total < needed) {
    return absl::FailedPreconditionError(
        absl::StrCat("`connections.total` of ", limits.total, " is too low for the ", agents,
                     " agents of ", config_.inventory, "; set it to ", needed, " or more"));
  }
  if (limits.per_address < kConnectionsOfAHost) {
    LogWarning("`connections.per_address` is too low for a host with a sensor and an actuator",
               {{"per_address", limits.per_address}, {"a_host_needs", kConnectionsOfAHost}});
  }
  if (allowed < wanted) {
    limits.total = static_cast<int>((std::max(allowed, kOtherDescriptors) - kOtherDescriptors) / 2);
    if (limits.total < needed) {
      return absl::FailedPreconditionError(
          absl::StrCat("the limit of ", allowed, " open files is too low for the ", agents,
                       " agents of ", config_.inventory, "; set LimitNOFILE of the unit to ",
                       2 * needed + kOtherDescriptors, " or more"));
    }
    limits.reserve = std::min(limits.reserve, limits.total / 4);
    LogWarning("the limit of open files is too low for `connections.total`",
               {{"limit", allowed}, {"wanted", wanted}, {"connections", limits.total}});
  }
  RIPS_ASSIGN_OR_RETURN(
      connections_,
      rpc::ConnectionGuard::Listen(
          config_.listen,
          {.admission = limits,
           .per_operator = config_.operators.streams + kConnectionsForCalls,
           .on_ended = [this](const auto& report) { attacks_->OnConnectionEnded(report); },
           .on_wasted = [this](const auto& address,
                               bool known) { attacks_->OnConnectionWasted(address, known); }},
          &clock_, &metrics_));
  return absl::OkStatus();
}

absl::Status Server::GuardPeers() {
  RIPS_RETURN_IF_ERROR(GuardConnections());
  RIPS_ASSIGN_OR_RETURN(bans_, operator_api::BanList::Load(store_.get()));
  certificates_ = std::make_unique<rpc::CertificateMonitor>(
      rpc::CertificateMonitor::Options{
          .own = config_.tls, .notify = [this](const auto& notice) { OnCertificate(notice); }},
      &clock_, &metrics_);
  certificates_->Check();  // so that readiness is known from the start
  gate_ = std::make_unique<rpc::CallGate>(
      &clock_,
      [this](const rpc::Peer& peer) {
        const std::optional<rpc::Refusal> revoked = credentials_->Revoked(peer);
        return revoked ? revoked : bans_->Against(peer);
      },
      &metrics_, connections_.get());
  gate_->set_on_admitted([this](const rpc::Peer& peer) {
    // A token's is used for a minute.
    if (peer.identity.role != rpc::Role::kEnrolment) certificates_->Seen(peer);
  });
  gate_->set_on_refused(
      [this](const rpc::Peer& peer, const rpc::Refusal& refusal, absl::string_view address) {
        attacks_->OnCallRefused(peer.identity, refusal.reason, address);
      });
  revocation_problem_ = metrics_.AddGauge(
      "rips_revocation_problem", "1 = the revocation lists are out of date or cannot be read.");
  watch_ = std::make_unique<rpc::SessionWatch>(&clock_, absl::Milliseconds(500), gate_.get());
  unread_ = std::make_unique<rpc::UnreadStreams>(
      &clock_, &metrics_,
      [this](const std::string& text) { OwnAlert(engine::Severity::kHigh, text); });
  watch_->set_unread(unread_.get());
  watch_->set_silence(std::max(rpc::SessionWatch::kSilence, 3 * config_.timing.lost));
  watch_->set_before_look([this] {
    LookAtRevocations();
    attacks_->Poll();
  });
  return absl::OkStatus();
}

absl::Status Server::OpenJail() {
  RIPS_ASSIGN_OR_RETURN(jail_, MakePluginJail(config_));
  for (const std::string& missing : jail_.missing) {
    LogWarning("plugin containment is incomplete", {{"why", missing}});
  }
  metrics_
      .AddGauge("rips_containment_missing",
                "Parts of the containment of plugins and scans that this machine cannot enforce.")
      .Set(static_cast<double>(jail_.missing.size()));
  return absl::OkStatus();
}

pipeline::StoreCounts Server::MakeStoreCounts() {
  const Gauge healthy =
      metrics_.AddGauge("rips_store_healthy", "1 while the store can be written, else 0.");
  const Counter failures =
      metrics_.AddCounter("rips_store_failures_total", "Writes that the store could not make.");
  return {.healthy = [healthy](bool ok) { healthy.Set(ok ? 1 : 0); },
          .failures = [failures](uint64_t by) { failures.Increment(static_cast<double>(by)); }};
}

pipeline::Counts Server::MakeCounts() {
  for (const char* reason : pipeline::kSkipReasons) InspectionsSkipped(metrics_, reason);
  const auto counter = [this](const char* name, const char* help) {
    const Counter made = metrics_.AddCounter(name, help);
    return [made](uint64_t by) { made.Increment(static_cast<double>(by)); };
  };
  return {
      .endpoints =
          [this](const std::string& robot, const pipeline::EndpointCounts& counts) {
            const auto set = [&](const char* visibility, size_t count) {
              metrics_
                  .AddGauge("rips_endpoints", "Endpoints on the robot, by what is seen of them.",
                            {{"robot", robot}, {"visibility", visibility}})
                  .Set(static_cast<double>(count));
            };
            set("watched", counts.watched);
            set("not_needed", counts.not_needed);
            set("not_visible", counts.not_visible);
          },
      .blind =
          [this](const std::string& robot, size_t reasons) {
            metrics_
                .AddGauge("rips_blind_reasons",
                          "Why a robot or an input of its sensors is not seen; 0 = it is.",
                          {{"robot", robot}})
                .Set(static_cast<double>(reasons));
          },
      .graph_left_out =
          [this](const std::string& robot, uint64_t left_out, bool began) {
            metrics_
                .AddGauge("rips_graph_left_out",
                          "Participants, nodes and endpoints left out of a robot's graph "
                          "because of a limit; 0 = the graph is whole.",
                          {{"robot", robot}})
                .Set(static_cast<double>(left_out));
            const Counter truncations =
                metrics_.AddCounter("rips_graph_truncations_total",
                                    "How often a robot's graph hit a limit.", {{"robot", robot}});
            if (began) truncations.Increment();
          },
      .clock_skew =
          [this](const std::string& robot, const std::string& host, int64_t ns) {
            ClockSkew(metrics_, robot, host).Set(static_cast<double>(ns) / kNanosPerSecond);
          },
      .inspections_skipped =
          [this](const std::string& reason, uint64_t by) {
            InspectionsSkipped(metrics_, reason).Increment(static_cast<double>(by));
          },
      .observations_judged =
          counter("rips_observations_judged_total", "Observations judged by rules."),
      .observations_lost = counter("rips_observations_lost_total",
                                   "Observations that sensors report or show as lost."),
      .observations_duplicate = counter("rips_observations_duplicate_total",
                                        "Observations received again and not judged again."),
      .messages_unattributed =
          counter("rips_messages_unattributed_total",
                  "Writers whose messages were judged without a node, since the graph did not "
                  "show them in time."),
      .graphs_merged = counter("rips_graphs_merged_total",
                               "Graphs judged together with the next one of their batch."),
      .sessions_refused =
          counter("rips_second_sessions_total",
                  "Sessions refused because the agent of that certificate has a live one."),
      .payloads_cut =
          counter("rips_payloads_cut_total", "Messages whose payload was longer than its limit."),
      .alerts = counter("rips_alerts_total", "Alerts raised."),
      .alerts_lost = counter("rips_alerts_lost_total",
                             "Alerts dropped while the store could not be written.")};
}

pipeline::PipelineReports Server::MakeReports() {
  const Counter late = metrics_.AddCounter(
      "rips_shard_late_total", "Times that a thread that judges was late by 500 ms or more.");
  const Counter deferred = metrics_.AddCounter(
      "rips_robots_deferred_total", "Times that a robot used more than its share for long.");
  const Counter moved = metrics_.AddCounter(
      "rips_robots_slow_total", "Times that a robot moved to the thread of slow robots.");
  const auto lateness = [this](const std::string& thread) {
    return metrics_.AddGauge("rips_shard_lateness_seconds",
                             "How late a thread that judges was at most, in the last 10 to 20 s.",
                             {{"shard", thread}});
  };
  lateness("slow").Set(0);  // on the page from the start
  return {.late =
              [this, late](const std::string& robot, int64_t late_ns) {
                late.Increment();
                OwnAlert(engine::Severity::kCritical,
                         absl::StrCat("a thread that judges robots was late by ",
                                      late_ns / kNanosPerMilli, " ms; ",
                                      robot.empty() ? "no robot" : absl::StrCat("robot ", robot),
                                      " used most of that time (told again after 10 s in time)"));
              },
          .deferred =
              [this, deferred](const std::string& robot) {
                deferred.Increment();
                alerts_->Raise(
                    robot, engine::Severity::kHigh,
                    absl::StrCat("robot ", robot, " uses more than its share of the server (",
                                 absl::FormatDuration(config_.fairness.cpu_per_second),
                                 " of processor a second): what its agents send waits, and rules "
                                 "lower no level of ",
                                 robot, " meanwhile (told again after a minute without)"));
              },
          .moved =
              [moved](const std::string& robot, bool slow) {
                if (slow) moved.Increment();
                LogInfo(slow ? "robot moves to the thread of slow robots"
                             : "robot returns from the thread of slow robots",
                        {{"robot", robot}});
              },
          .refused =
              [this, counter = metrics_.AddCounter(
                         "rips_backlog_refused_total",
                         "Streams and calls refused because too much of a robot waits.")](
                  const std::string& robot) {
                counter.Increment();
                attacks_->OnPeerRefused(robot);
              },
          .waited =
              [this](const std::string& robot, int64_t longest_ns) {
                metrics_
                    .AddGauge("rips_robot_wait_seconds",
                              "Longest wait of what was sent to a robot's thread, in one second.",
                              {{"robot", robot}})
                    .Set(static_cast<double>(longest_ns) / kNanosPerSecond);
              },
          .lateness =
              [lateness](const std::string& thread, int64_t longest_ns) {
                lateness(thread).Set(static_cast<double>(longest_ns) / kNanosPerSecond);
              },
          .advanced = advanced_};
}

std::shared_ptr<operator_api::CallerQuota> Server::MakeQuota() {
  const Counter refused = metrics_.AddCounter(
      "rips_quota_refused_total", "Calls of operators refused because their quota was used up.");
  operator_api::QuotaLimits limits;
  limits.streams.at_a_time = config_.operators.streams;
  limits.queries.at_a_time = config_.operators.calls;
  limits.queries.per_second = config_.operators.calls_per_second;
  limits.queries.burst = 2 * limits.queries.per_second;
  return operator_api::CallerQuota::Create(&clock_, limits, [refused] { refused.Increment(); });
}

void Server::OpenActivations() {
  rollouts_.activations = std::make_unique<rollout::Activations>(
      absl::StrCat(config_.bundles_dir, "/activated.json"), store_.get());
  rollouts_.rates = std::make_unique<rollout::AlertRates>(hub_.get(), &clock_);
  const auto* activations = rollouts_.activations.get();
  rollouts_.policies = std::make_unique<PolicySource>(
      PolicySource::Options{.bundles_source = config_.bundles_source,
                            .bundles_dir = config_.bundles_dir,
                            .activated = [activations = rollouts_.activations.get()](
                                             const auto& robot) { return activations->For(robot); },
                            .needed = [activations] { return activations->now().bundles(); }},
      [this](const std::string& dir, const std::string& name) {
        return loader_->LoadPolicy(dir, name);
      });
  if (activations->problem().ok()) return;
  OwnAlert(
      engine::Severity::kCritical,
      absl::StrCat("which bundles were activated is not known: ", activations->problem().message(),
                   "; each robot keeps the bundle that judged it last; activate them anew "
                   "(`ripsctl rules status`, `ripsctl rules activate`)"));
}

void Server::OpenBundleControl() {
  rollouts_.library = std::make_unique<rollout::BundleLibrary>(
      config_.bundles_dir, [this](const std::string& dir) { return loader_->LoadPushed(dir); },
      [this](const std::string& dir, const std::string& id) { return loader_->SignedBy(dir, id); });
  bundles_ = std::make_unique<rollout::BundleControl>(rollout::BundleControl::Parts{
      .fleet = fleet_.get(),
      .activations = rollouts_.activations.get(),
      .library = rollouts_.library.get(),
      .rates = rollouts_.rates.get(),
      .policies = rollouts_.policies.get(),
      .shadows = &rollouts_.shadows,
      .load_shadow =
          [this](const rollout::KeptBundle& kept) -> absl::StatusOr<shadow::ShadowPolicy> {
        RIPS_ASSIGN_OR_RETURN(const std::string dir,
                              bundle::KeptBundlePath(config_.bundles_dir, kept.id));
        return loader_->LoadShadow(dir, kept.id);
      },
      .pipeline = pipeline_.get(),
      .alerts = alerts_.get(),
      .clock = &clock_,
      .new_id = NewId});
  // What each robot keeps instead; a file that could not be read may be in order the next time.
  if (!absl::IsDataLoss(rollouts_.activations->problem())) return;
  if (const absl::Status kept = rollouts_.activations->Set(rollouts_.activations->now());
      !kept.ok()) {
    LogError("cannot record which bundles robots keep", {{"reason", kept.message()}});
  }
}

absl::Status Server::AddRobots() {
  RIPS_RETURN_IF_ERROR(recorder_->BeginGeneration(absl::HexStringToBytes(NewId())));
  OpenActivations();
  const int shards = config_.shards > 0
                         ? config_.shards
                         : static_cast<int>(std::clamp(std::thread::hardware_concurrency(), 1u,
                                                       static_cast<unsigned>(kShardsMax)));
  const Fairness& fairness = config_.fairness;
  pipeline_ = std::make_unique<pipeline::Pipeline>(
      shards, &clock_,
      pipeline::PipelineLimits{
          .time_step_ns = TimeStepNs(config_.timing),
          .cpu_per_second_ns = absl::ToInt64Nanoseconds(fairness.cpu_per_second),
          .cpu_burst_ns = absl::ToInt64Nanoseconds(fairness.cpu_burst),
          .long_task_ns = absl::ToInt64Nanoseconds(fairness.long_task)},
      MakeReports());
  const auto robots = [this](const char* policy, size_t count) {
    metrics_
        .AddGauge("rips_robots", "Robots of the inventory, by the policy that judges them.",
                  {{"policy", policy}})
        .Set(static_cast<double>(count));
  };
  const pipeline::Counts counts = MakeCounts();
  std::function<std::unique_ptr<pipeline::FlightRecorder>(const std::string&)> flight_recorder;
  if (auto* archive = recordings_.archive.get()) {
    flight_recorder = [archive](const std::string& robot) { return archive->NewRecorder(robot); };
  }
  fleet_metrics_ = std::make_unique<FleetMetrics>(pipeline_.get(), &clock_, &metrics_);
  fleet_ = std::make_unique<Fleet>(
      FleetOptions{.inventory = config_.inventory, .timing = ToPipeline(config_.timing)},
      store_.get(), pipeline_.get(), alerts_.get(), rollouts_.policies.get(),
      pipeline::Ports{.recorder = recorder_.get(),
                      .audience = rollouts_.rates.get(),
                      .counts = counts,
                      .flight_recorder = flight_recorder,
                      .new_id = NewId},
      FleetCounts{.robots =
                      [robots](size_t armed, size_t on_last_good, size_t held) {
                        robots("current", armed);
                        robots("last_good", on_last_good);
                        robots("none", held);
                      },
                  .listed =
                      [this, counts](const bundle::InventoryRobot& robot) {
                        // What an earlier robot of that name has left.
                        counts.endpoints(robot.id, {});
                        counts.graph_left_out(robot.id, 0, false);
                        for (const bundle::InventorySensor& sensor : robot.sensors) {
                          ClockSkew(metrics_, robot.id, sensor.host)
                              .Set(std::numeric_limits<double>::quiet_NaN());
                        }
                      },
                  .inventory =
                      [this](const bundle::Inventory& now, bool refused) {
                        if (listed_.outdated.exchange(refused) && !refused) {
                          OwnAlert(engine::Severity::kInfo, "the inventory is in force again");
                        }
                        fleet_metrics_->SetInventory(now);
                        listed_.contacts.SetListed(AgentsOf(now));
                        listed_.labels.Set(LabelsOf(now));
                        listed_.settings.Set(now.settings);
                        if (enrolling_.enrolment != nullptr)
                          enrolling_.enrolment->SetInventory(now);
                      }});
  RIPS_RETURN_IF_ERROR(fleet_->Start());
  OpenBundleControl();
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
  const auto pauses = [this](const char* agent) {
    return metrics_.AddCounter("rips_reading_pauses_total", "Times that a session was not read.",
                               {{"agent", agent}});
  };
  const wire_limits::LimitCounters fields_refused(&metrics_);
  sensors_ = std::make_unique<ingest::SensorService>(
      pipeline_.get(), watch_.get(),
      ingest::IngestMetrics{.malformed = malformed("sensor"),
                            .streams = streams("sensor"),
                            .interests_refused = metrics_.AddCounter(
                                "rips_interests_refused_total",
                                "Lists of wanted payloads that sensors could not apply."),
                            .fields_refused = fields_refused,
                            .pauses = pauses("sensor")},
      &listed_.contacts);
  actuators_ = std::make_unique<dispatch::ActuatorService>(
      pipeline_.get(), watch_.get(),
      dispatch::DispatchMetrics{
          .malformed = malformed("actuator"),
          .streams = streams("actuator"),
          .commands = metrics_.AddCounter("rips_commands_total", "Commands sent to actuators."),
          .fields_refused = fields_refused,
          .pauses = pauses("actuator")},
      audit_ == nullptr
          ? dispatch::AuditHeads()
          : dispatch::AuditHeads{
                .newest = [audit = audit_.get()] { return audit->sealed(); },
                .returned =
                    [heads = heads_.get()](const auto& robot, const auto& host, auto head) {
                      heads->Compare({robot, host}, std::move(head));
                    }},
      &listed_.contacts);
  operators_ = std::make_unique<operator_api::OperatorService>(
      pipeline_.get(), store_.get(), hub_.get(),
      operator_api::OperatorService::Access{
          .watch = watch_.get(),
          .bans = bans_.get(),
          .certificates = certificates_.get(),
          .fields_refused = fields_refused,
          .on_refused_field =
              [this](const rpc::Peer& peer, const auto& address, const auto& what) {
                OwnAlert(engine::Severity::kHigh,
                         absl::StrCat(rpc::Describe(peer), " at ", address,
                                      " sent a request past a limit: ", what, "; it was refused"));
              },
          .quota = MakeQuota(),
          .audit = orders_.get(),
          .store_writable = [this] { return committer_->healthy(); },
          .recordings = recordings_.files.get(),
          .bundles = bundles_.get(),
          .acks = store_.get(),
          .committer = committer_.get(),
          .enrolment = enrolling_.enrolment.get(),
          .contacts = &listed_.contacts,
          .labels = &listed_.labels,
          .settings = &listed_.settings});
  enrolment_service_ = std::make_unique<enrol::EnrolmentService>(enrolling_.enrolment.get(),
                                                                 watch_.get(), orders_.get());
  const rpc::RpcServerOptions options = {config_.listen, connections_.get(), gate_.get(),
                                         credentials_->ForServer()};
  RIPS_ASSIGN_OR_RETURN(
      rpc_, rpc::RpcServer::Start(options, {sensors_.get(), actuators_.get(), operators_.get(),
                                            enrolment_service_.get()}));
  fleet_metrics_->Start({.certificates = certificates_.get(),
                         .sessions = watch_.get(),
                         .shadows = &rollouts_.shadows,
                         .orders = &bundles_->thread(),
                         .pushes = &bundles_->pushes(),
                         .committer = committer_.get(),
                         .store_path = config_.store_path});
  listening_ = true;
  LogInfo("listening", {{"address", rpc_->address()}, {"metrics", page_->address()}});
  return absl::OkStatus();
}

absl::Status Server::Readiness() const {
  if (!listening_) return absl::UnavailableError("waiting for a usable certificate");
  RIPS_RETURN_IF_ERROR(certificates_->own_status());
  RIPS_RETURN_IF_ERROR(connections_->Probe(kProbePatience));
  return DiskHealth();
}

absl::Status Server::DiskHealth() const {
  const absl::Status audited = audit_ == nullptr ? absl::OkStatus() : audit_->health();
  if (!audited.ok()) {
    return absl::UnavailableError(absl::StrCat("the audit log ", config_.audit_dir,
                                               " cannot be written: ", audited.message()));
  }
  const absl::Status health = committer_->health();
  if (health.ok()) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat("the store ", config_.store_path, " cannot be written: ", health.message()));
}

std::string Server::Describe() const {
  absl::Status problem = DiskHealth();
  problem.Update(certificates_->own_status());
  return absl::StrCat("serving on ", address(), "; robots judged: ", pipeline_->robots().size(),
                      ", without a policy: ", pipeline_->held().size(),
                      listed_.outdated ? "; the inventory on disk is refused" : "",
                      problem.ok() ? "" : "; ", problem.message());
}

void Server::Reload() {
  if (const absl::Status status = alert_log_->Reopen(); !status.ok()) {
    LogError("cannot reopen the alert file", {{"reason", status.message()}});
  }
  const bool reloaded = bundles_->Reload([this] {
    if (const absl::Status read = loader_->ReadKeys(); !read.ok()) {
      OwnAlert(engine::Severity::kHigh,
               absl::StrCat("the keys of bundles are not read anew, the old ones count: ",
                            read.message()));
    }
  });
  if (reloaded) return;
  LogWarning(
      "inventory and bundles are not read anew: too many orders about bundles wait; send SIGHUP "
      "again");
}

void Server::Stop() {
  if (std::exchange(stopped_, true) || pipeline_ == nullptr) return;
  if (fleet_metrics_ != nullptr) fleet_metrics_->Stop();
  if (rpc_ != nullptr) {
    LogInfo("stopping");
    rpc_->SetServing(false);
    for (const std::string& robot :
         pipeline_->ForEach([](pipeline::Robot& each) { each.Drain(); })) {
      LogWarning("robot not drained in time; its last lease stands", {{"robot", robot}});
    }
    watch_->CloseAll(grpc::Status(grpc::StatusCode::UNAVAILABLE, "the server is stopping"));
    // Else its calls would hold up the end.
    if (enrolling_.external_ca != nullptr) enrolling_.external_ca->Stop();
    rpc_->Shutdown(kShutdownGrace);
  }
  if (bundles_ != nullptr) bundles_->Stop();
  rollouts_.shadows.Stop();
  // What is still being inspected is judged by whoever gets it again.
  pipeline_->Stop();
  inspections_->Stop();
  outputs_->Stop();
  // Their last alerts are written with the rest.
  heads_.reset();
  store_watch_.reset();
  committer_->Stop();
  hub_->feed().Stop();
}

}  // namespace rips::server
