// The policy server, wired: the order of members is the order of start, and in reverse of stop.
#ifndef RIPS_POLICY_SERVER_SERVER_SERVER_H_
#define RIPS_POLICY_SERVER_SERVER_SERVER_H_

#include <atomic>
#include <functional>
#include <memory>
#include <source_location>
#include <string>

#include "absl/base/thread_annotations.h"
#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/policy/inspect/inspection_pool.h"
#include "policy_server/server/attack_alerts.h"
#include "policy_server/server/audit/audit_log.h"
#include "policy_server/server/audit/order_audit.h"
#include "policy_server/server/audit/returned_heads.h"
#include "policy_server/server/bundle_loader.h"
#include "policy_server/server/config/config.h"
#include "policy_server/server/dispatch/actuator_service.h"
#include "policy_server/server/enrol/enrolment.h"
#include "policy_server/server/enrol/enrolment_service.h"
#include "policy_server/server/fleet.h"
#include "policy_server/server/fleet_metrics.h"
#include "policy_server/server/flight/flight_archive.h"
#include "policy_server/server/flight/flight_files.h"
#include "policy_server/server/ingest/sensor_service.h"
#include "policy_server/server/operator_api/ban_list.h"
#include "policy_server/server/operator_api/operator_service.h"
#include "policy_server/server/operator_api/status_broadcaster.h"
#include "policy_server/server/outputs/outputs.h"
#include "policy_server/server/plugin_jail.h"
#include "policy_server/server/policy_source.h"
#include "policy_server/server/rollout/activated_bundles.h"
#include "policy_server/server/rollout/alert_rates.h"
#include "policy_server/server/rollout/bundle_control.h"
#include "policy_server/server/rollout/bundle_library.h"
#include "policy_server/server/shadow/shadows.h"
#include "policy_server/server/shard/agent_contacts.h"
#include "policy_server/server/shard/pipeline.h"
#include "policy_server/server/shard/robot_labels.h"
#include "policy_server/server/shard/server_alerts.h"
#include "policy_server/server/shard/store_recorder.h"
#include "policy_server/server/shard/store_watch.h"
#include "policy_server/server/store/alert_log.h"
#include "policy_server/server/store/committer.h"
#include "policy_server/server/store/sqlite_enrolments.h"
#include "policy_server/server/store/sqlite_store.h"
#include "services/rpc/call_gate.h"
#include "services/rpc/certificate_monitor.h"
#include "services/rpc/connection_guard.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/session_watch.h"
#include "services/rpc/unread_streams.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"
#include "services/runtime/real_clock.h"

namespace rips::server {

// Of the inventory in force, for lists of robots.
struct Listed {
  pipeline::AgentContacts contacts;
  pipeline::RobotLabels labels;
  pipeline::ListedSettings settings;
  // It is an older one than that on disk.
  std::atomic<bool> outdated = false;
};

class Server {
 public:
  // Waits so long; true ends the wait for good.
  using Pause = std::function<bool(absl::Duration)>;
  // Reads inventory, bundles and the store, serves /metrics, waits for usable certificates, then
  // listens. Every error names the file and the remedy; InvalidArgument: no waiting mends it.
  // Cancelled: `pause` ended the wait; without one nothing is waited for.
  // `advanced`: as PipelineReports::advanced, on a thread of the pipeline; may be null.
  // `settings`: `config` as it was read, for operators.
  static absl::StatusOr<std::unique_ptr<Server>> Start(const ServerConfig& config,
                                                       const Pause& pause = nullptr,
                                                       std::function<void()> advanced = nullptr,
                                                       std::vector<ConfigSetting> settings = {});
  // As Stop.
  ~Server();

  // Reads inventory and bundles anew (Fleet) and opens the alert file anew.
  void Reload();
  // Grants long leases, ends all streams, makes everything durable. Idempotent.
  void Stop();

  // `listen` with the real port.
  const std::string& address() const { return rpc_->address(); }
  // A line for `systemctl status`: what is served, and problems. It may hold untrusted text.
  std::string Describe() const;

 private:
  Server(const ServerConfig& config, std::function<void()> advanced,
         std::vector<ConfigSetting> settings);
  absl::Status Open();
  absl::Status ServePage();
  absl::Status AwaitCredentials(const Pause& pause);
  // Judges peers, and watches certificates, our own among them.
  absl::Status GuardPeers();
  absl::Status GuardConnections();
  // RIPS's own alert that is no robot's: of robot `(server)`. Any thread.
  // Each caller is a kind, for the limit.
  void OwnAlert(engine::Severity severity, const std::string& text,
                std::source_location where = std::source_location::current());
  void OnCertificate(const rpc::CertificateMonitor::Notice& notice);
  // Reads the revocation lists if they have changed, and says what is wrong with them.
  void LookAtRevocations();
  absl::Status OpenJail();
  // What is wrong with them is an alert: robots are judged all the same.
  void OpenRecordings();
  absl::Status AddRobots();
  // As OpenRecordings: without it no certificates are issued.
  void OpenEnrolment();
  // Before robots are added, and after that.
  void OpenActivations();
  void OpenBundleControl();
  absl::Status Listen();
  pipeline::Counts MakeCounts();
  pipeline::StoreCounts MakeStoreCounts();
  pipeline::PipelineReports MakeReports();
  std::shared_ptr<operator_api::CallerQuota> MakeQuota();
  absl::Status Readiness() const;
  // OK while the audit log and the store can be written.
  absl::Status DiskHealth() const;

  const ServerConfig config_;
  const std::function<void()> advanced_;
  RealClock clock_;
  Metrics metrics_;
  Listed listed_;
  std::shared_ptr<const rpc::Credentials> credentials_;
  // What plugins and scanners run in.
  PluginJail jail_;
  // After what plugins and scanners answer to, before what asks them.
  std::unique_ptr<inspect::InspectionPool> inspections_;
  std::unique_ptr<store::SqliteStore> store_;
  // Null if none is configured.
  std::unique_ptr<audit::AuditLog> audit_;
  std::unique_ptr<audit::OrderAudit> orders_;
  std::unique_ptr<store::AlertLog> alert_log_;
  std::unique_ptr<operator_api::StatusBroadcaster> hub_;
  std::unique_ptr<store::Committer> committer_;
  std::unique_ptr<pipeline::ServerAlerts> alerts_;
  // Null if there is no audit log.
  std::unique_ptr<audit::ReturnedHeads> heads_;
  std::unique_ptr<AttackAlerts> attacks_;
  std::unique_ptr<pipeline::StoreWatch> store_watch_;
  std::unique_ptr<outputs::Outputs> outputs_;
  std::unique_ptr<pipeline::StoreRecorder> recorder_;
  // Both null if no recordings are kept.
  struct Recordings {
    std::unique_ptr<flight::FlightFiles> files;
    std::unique_ptr<flight::FlightArchive> archive;
  };
  Recordings recordings_;
  // All null if no certificates are issued; `external_ca` also if our own key signs.
  struct Enrolling {
    std::unique_ptr<store::SqliteEnrolments> store;
    std::unique_ptr<enrol::ExternalCa> external_ca;
    std::unique_ptr<enrol::Enrolment> enrolment;
  };
  Enrolling enrolling_;
  std::unique_ptr<BundleLoader> loader_;
  // What operators order of bundles; in the order of start.
  struct Rollouts {
    std::unique_ptr<rollout::Activations> activations;
    std::unique_ptr<rollout::AlertRates> rates;
    // Before the robots, which call its taps.
    shadow::Shadows shadows;
    std::unique_ptr<PolicySource> policies;
    std::unique_ptr<rollout::BundleLibrary> library;
  };
  Rollouts rollouts_;
  std::unique_ptr<pipeline::Pipeline> pipeline_;
  std::unique_ptr<FleetMetrics> fleet_metrics_;
  std::unique_ptr<Fleet> fleet_;
  std::unique_ptr<rollout::BundleControl> bundles_;
  std::unique_ptr<operator_api::BanList> bans_;
  std::unique_ptr<rpc::CertificateMonitor> certificates_;
  std::unique_ptr<rpc::ConnectionGuard> connections_;
  std::unique_ptr<rpc::CallGate> gate_;
  Gauge revocation_problem_;
  Mutex revocation_mu_;
  std::string revocation_told_ ABSL_GUARDED_BY(revocation_mu_);
  std::unique_ptr<rpc::UnreadStreams> unread_;
  std::unique_ptr<rpc::SessionWatch> watch_;
  std::unique_ptr<ingest::SensorService> sensors_;
  std::unique_ptr<dispatch::ActuatorService> actuators_;
  std::unique_ptr<operator_api::OperatorService> operators_;
  std::unique_ptr<enrol::EnrolmentService> enrolment_service_;
  std::unique_ptr<rpc::RpcServer> rpc_;
  std::atomic<bool> listening_ = false;
  std::unique_ptr<MetricsPage> page_;
  bool stopped_ = false;
};

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_SERVER_H_
