// What an on-call person needs to know of the robots and of the server, on the metrics page.
//
// A Look every 2 s, on a thread of its own, asks each robot for its facts, as an order on its
// thread, and waits for none: it shows what has been answered since the Look before. The page
// formats copies; no lock of a shard is held then.
//
//   a robot                      its series
//   judged                       all, as it said last; rips_robot_status_age_seconds says when
//   held                         those that the server knows without it
//   not in the inventory         none, nor those that others count of it or of its hosts
//
// Names in labels are of the inventory, and of levels and bundles in force there: what an agent
// says adds no series. METRICS.md lists every metric of the server.
#ifndef RIPS_POLICY_SERVER_SERVER_FLEET_METRICS_H_
#define RIPS_POLICY_SERVER_SERVER_FLEET_METRICS_H_

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/time/time.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/server/rollout/order_thread.h"
#include "policy_server/server/shadow/shadows.h"
#include "policy_server/server/shard/pipeline.h"
#include "policy_server/server/store/committer.h"
#include "services/base/clock.h"
#include "services/rpc/certificate_monitor.h"
#include "services/rpc/session_watch.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"
#include "services/runtime/ticker.h"

namespace rips::server {

// What is looked at beside the robots; null = its series are not shown. Nothing is owned; all
// outlive Stop.
struct FleetMetricsSources {
  const rpc::CertificateMonitor* certificates = nullptr;
  rpc::SessionWatch* sessions = nullptr;
  const shadow::Shadows* shadows = nullptr;
  const rollout::OrderThread* orders = nullptr;
  const rollout::OrderThread* pushes = nullptr;
  const store::Committer* committer = nullptr;
  // The SQLite file; empty = its size is not shown.
  std::string store_path;
};

class FleetMetrics {
 public:
  static constexpr absl::Duration kInterval = absl::Seconds(2);

  // Nothing is owned; all outlive this.
  FleetMetrics(pipeline::Pipeline* pipeline, const Clock* clock, Metrics* metrics);

  // The inventory in force. From now on the page shows no counter, gauge or histogram of other
  // robots and hosts; the tables that Look fills follow with the next Look. Any thread.
  void SetInventory(const bundle::Inventory& inventory) ABSL_LOCKS_EXCLUDED(mu_);
  // Looks every `interval`; InfiniteDuration = only when asked. Once.
  void Start(FleetMetricsSources sources, absl::Duration interval = kInterval);
  // Waits for a Look that runs. Before the pipeline stops. Idempotent.
  void Stop() { ticker_.reset(); }
  // One thread at a time, after Start; not beside the thread of its own.
  void Look() ABSL_LOCKS_EXCLUDED(mu_);

  // Hosts of one robot of the inventory.
  struct Hosts {
    std::set<std::string> sensors;
    std::set<std::string> actuators;
  };
  using Listed = std::map<std::string, Hosts>;

 private:
  // What a robot says of itself.
  struct Facts {
    pipeline::RobotStatus status;
    // Least restrictive first; none = the robot is held.
    std::vector<std::string> levels;
    size_t sensors = 0;
    size_t actuators = 0;
    // CLOCK_BOOTTIME.
    int64_t at_ns = 0;
  };
  struct Answer;
  struct Asked {
    std::shared_ptr<Answer> answer;
    // Held by the task, which runs or is dropped.
    std::weak_ptr<void> task;
  };
  using AllFacts = std::map<std::string, Facts>;
  struct Tables;

  AllFacts Collect(const Listed& listed);
  void Ask(const Listed& listed);
  void ShowLevels(const AllFacts& facts) const;
  void ShowStates(const AllFacts& facts, const Listed& listed) const;
  void ShowQueues(const Listed& listed) const;
  void ShowCertificates(const Listed& listed) const;
  void ShowShadows(const Listed& listed) const;
  void ShowServer();

  pipeline::Pipeline* const pipeline_;
  const Clock* const clock_;
  Metrics* const metrics_;
  const std::shared_ptr<const Tables> tables_;
  FleetMetricsSources sources_;
  // By robot; of Look.
  std::map<std::string, Asked> asked_;
  // As counted by Committer::refused.
  uint64_t refused_ = 0;
  Mutex mu_;
  std::shared_ptr<const Listed> listed_ ABSL_GUARDED_BY(mu_) = std::make_shared<Listed>();
  std::optional<Ticker> ticker_;  // last: uses the others
};

// True unless the labels are of a robot, or of a host of a robot, that is not listed: those with
// `robot`, with `robot` and `host`, and with `whose="peer"` and the role and name of an agent.
bool IsShown(const FleetMetrics::Listed& listed, const MetricLabels& labels);

}  // namespace rips::server

#endif  // RIPS_POLICY_SERVER_SERVER_FLEET_METRICS_H_
