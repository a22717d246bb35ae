// The policy server, wired: the order of members is the order of start, and in reverse of stop.
#ifndef RIPS_POLICY_SERVER_SERVER_H_
#define RIPS_POLICY_SERVER_SERVER_H_

#include <memory>
#include <string>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "policy_server/bundle/bundle.h"
#include "policy_server/bundle/inventory.h"
#include "policy_server/config/config.h"
#include "policy_server/dispatch/actuator_service.h"
#include "policy_server/ingest/sensor_service.h"
#include "policy_server/inspect/inspection_pool.h"
#include "policy_server/operator_api/hub.h"
#include "policy_server/operator_api/operator_service.h"
#include "policy_server/pipeline/pipeline.h"
#include "policy_server/pipeline/store_recorder.h"
#include "policy_server/store/alert_log.h"
#include "policy_server/store/committer.h"
#include "policy_server/store/sqlite_store.h"
#include "services/rpc/credentials.h"
#include "services/rpc/server_builder.h"
#include "services/rpc/session_watch.h"
#include "services/runtime/metrics.h"
#include "services/runtime/real_clock.h"

namespace rips::server {

class Server {
 public:
  // Reads certificates, inventory, bundles and the store, then listens. Every error names the file
  // and the remedy.
  static absl::StatusOr<std::unique_ptr<Server>> Start(const ServerConfig& config);
  // As Stop.
  ~Server();

  // Reads the bundles anew and opens the alert file anew. A bundle that is refused leaves the old
  // one in force and says so.
  void Reload();
  // Grants long leases, ends all streams, makes everything durable. Idempotent.
  void Stop();

  // `listen` with the real port.
  const std::string& address() const { return rpc_->address(); }

 private:
  explicit Server(const ServerConfig& config);
  absl::Status Open();
  absl::Status LoadPolicies();
  absl::StatusOr<pipeline::Policy> LoadPolicy(const std::string& dir, const std::string& name);
  absl::Status AddRobots();
  absl::Status Listen();
  pipeline::Counts MakeCounts();
  absl::Status Readiness() const;

  const ServerConfig config_;
  RealClock clock_;
  Metrics metrics_;
  std::shared_ptr<const rpc::Credentials> credentials_;
  bundle::Inventory inventory_;
  // By name.
  absl::btree_map<std::string, pipeline::Policy> policies_;
  // After what plugins and scanners answer to, before what asks them.
  std::unique_ptr<inspect::InspectionPool> inspections_;
  std::unique_ptr<store::Store> store_;
  std::unique_ptr<store::AlertLog> alert_log_;
  std::unique_ptr<operator_api::Hub> hub_;
  std::unique_ptr<store::Committer> committer_;
  std::unique_ptr<pipeline::StoreRecorder> recorder_;
  std::unique_ptr<pipeline::Pipeline> pipeline_;
  std::unique_ptr<rpc::SessionWatch> watch_;
  std::unique_ptr<ingest::SensorService> sensors_;
  std::unique_ptr<dispatch::ActuatorService> actuators_;
  std::unique_ptr<operator_api::OperatorService> operators_;
  std::unique_ptr<rpc::RpcServer> rpc_;
  std::unique_ptr<MetricsServer> metrics_server_;
  bool stopped_ = false;
};

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_H_
