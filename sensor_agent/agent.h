// The sensor: watches one DDS domain, keeps its graph, and hands what it sees to the uplink.
#ifndef RIPS_SENSOR_AGENT_AGENT_H_
#define RIPS_SENSOR_AGENT_AGENT_H_

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "sensor_agent/config.h"
#include "sensor_agent/dds/domain_watch.h"
#include "sensor_agent/findings/findings.h"
#include "sensor_agent/graph/graph_builder.h"
#include "sensor_agent/graph/graph_limits_watch.h"
#include "sensor_agent/graph/own_participants.h"
#include "sensor_agent/ids/ids_feed.h"
#include "sensor_agent/interest/interest.h"
#include "sensor_agent/messages/message_flow.h"
#include "sensor_agent/messages/sequence_watch.h"
#include "sensor_agent/uplink/uplink.h"
#include "sensor_agent/wire/wire_input.h"
#include "services/base/clock.h"
#include "services/base/config_setting.h"
#include "services/dds/node_announcer.h"
#include "services/rpc/certificate_monitor.h"
#include "services/rpc/credentials.h"
#include "services/runtime/log_limiter.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

class Agent {
 public:
  // See Uplink::Hooks.
  using OnSettings = std::function<void(std::vector<ConfigSetting>)>;

  // Joins the domain; nothing runs yet. `clock`, `metrics` and `monitor` (may be null) are not
  // owned and outlive this. While `credentials` cannot be used, what is seen is kept as if the
  // server were away. The middleware's errors, except for want of a network interface: then
  // no_domain() says so, and it reports all but DDS.
  static absl::StatusOr<std::unique_ptr<Agent>> Create(const SensorConfig& config,
                                                       rpc::CredentialsSource credentials,
                                                       const Clock* clock, Metrics* metrics,
                                                       rpc::CertificateMonitor* monitor = nullptr,
                                                       OnSettings on_settings = nullptr);
  ~Agent();

  // The observer thread calls `on_turn`, which may be null, at least once a second unless it hangs.
  void Start(std::function<void()> on_turn = nullptr);
  // Joins all threads. What is unacknowledged is spooled for the next process, or gone if there is
  // no spool.
  void Stop();

  // A signal of this name came in. Any thread.
  void OnSignal(const std::string& name) ABSL_LOCKS_EXCLUDED(inbox_mu_);
  // OK while the policy server takes what is seen. Any thread.
  absl::Status Ready() const { return uplink_->Ready(); }
  // Why there is no DDS here; OK if there is. Any thread.
  const absl::Status& no_domain() const { return no_domain_; }
  // none() without a domain. Any thread.
  ros2::Guid participant() const { return domain_ != nullptr ? domain_->own() : ros2::Guid(); }
  // Of the domain, if there is one. Any thread.
  dds::InterfacesInUse interfaces() const {
    return domain_ != nullptr ? domain_->participant().interfaces() : dds::InterfacesInUse();
  }
  // The graph has settled, and there was a node of the robot. Any thread.
  bool sees_robot() const { return sees_robot_; }
  // What is wrong with DDS here, for the server: evidence is incomplete meanwhile; empty = nothing.
  // Any thread.
  void SayDdsProblem(const std::string& why);
  // See Uplink. Any thread.
  void SayConfiguration(const std::vector<ConfigSetting>& settings,
                        const std::vector<std::string>& refused) {
    uplink_->SayConfiguration(settings, refused);
  }

 private:
  Agent(const SensorConfig& config, const Clock* clock, Metrics* metrics);

  // Wakes the observer thread. Any thread; cheap when it is awake already.
  void Wake() ABSL_LOCKS_EXCLUDED(inbox_mu_);
  // Waits until woken, but not past `deadline_ns`. False when stopping.
  bool WaitForWork(int64_t deadline_ns) ABSL_LOCKS_EXCLUDED(inbox_mu_);

  // --- Observer thread
  void Observe(const std::function<void()>& on_turn);
  // Hands to the uplink what has come.
  void Poll(int64_t now_ns);
  void ApplyInbox(int64_t now_ns, Observations& seen) ABSL_LOCKS_EXCLUDED(inbox_mu_);
  void PollDomain(int64_t now_ns, Observations& seen);
  void PollDiscovery(int64_t now_ns, Observations& seen);
  void PollCoverage(int64_t now_ns);
  void OnParticipant(const ros2::Participant& participant, bool alive, int64_t now_ns);
  // RIPS's participants have changed.
  void ApplyOwnParticipants(int64_t now_ns);
  void StartAnnouncing();
  void Announce(int64_t now_ns);
  // Has what `watch_` says read from now on.
  void FollowPlan(int64_t now_ns);
  void OnEndpoint(const EndpointFact& endpoint, bool alive, int64_t now_ns);
  // The numbers of a writer jumped, as whoever says so: any number of times.
  void OnSequenceJump(const SequenceJump& jump);
  void PollSequences(int64_t now_ns);
  void PollClaims(int64_t now_ns, Observations& seen);
  void PollSamples(int64_t now_ns, Observations& seen);
  void PollFindings(int64_t now_ns, Observations& seen);
  void PollWire(int64_t now_ns, Observations& seen);
  // Says of those in `seen` and before which stand, and whether these are all.
  void SumFindings(int64_t now_ns, Observations& seen);
  // Which writers are read, for the judgement of what is on the wire.
  void ReportReaders(int64_t now_ns);
  void CountLimits(int64_t now_ns, Observations& seen);
  // `left_out` of the graph by a limit since the last call.
  void WatchGraphLimits(uint64_t left_out, int64_t now_ns);
  // Has discovery report everything that is there once more.
  void Rediscover(int64_t now_ns);
  // The whole graph in place of its steps.
  void ResendGraph(int64_t now_ns);
  // Those that stand.
  void RepeatFindings(int64_t now_ns, Observations& seen);
  int64_t NextWork() const;

  const SensorConfig config_;
  const Clock* clock_;
  Counter samples_;
  Counter duplicates_;
  Counter unattributed_;
  Counter payloads_shed_;
  Counter foreign_claims_;
  Counter bad_claims_;
  Counter lost_;
  Gauge readers_;
  Gauge graph_left_out_;
  Gauge announced_;

  absl::Status no_domain_;
  std::atomic<bool> sees_robot_ = false;
  std::atomic<bool> woken_ = false;
  Mutex inbox_mu_;
  CondVar inbox_cond_;
  bool stopping_ ABSL_GUARDED_BY(inbox_mu_) = false;
  std::vector<std::string> signals_ ABSL_GUARDED_BY(inbox_mu_);
  std::optional<std::vector<ros2::Guid>> own_participants_ ABSL_GUARDED_BY(inbox_mu_);
  std::optional<std::vector<std::string>> protected_parts_ ABSL_GUARDED_BY(inbox_mu_);
  // Not yet observed; the newest takes the place of those before. Null = none.
  std::shared_ptr<const Interest> interest_ ABSL_GUARDED_BY(inbox_mu_);
  std::optional<bool> primary_ ABSL_GUARDED_BY(inbox_mu_);
  bool server_forgot_ ABSL_GUARDED_BY(inbox_mu_) = false;

  // The observer thread's.
  LogLimiter bus_logs_;  // of what any participant on the bus can trigger
  std::optional<GraphBuilder> graph_;
  std::optional<MessageFlow> flow_;
  std::optional<Findings> findings_;
  std::optional<SequenceWatch> sequences_;
  OwnParticipants own_;
  uint64_t findings_dropped_ = 0;
  std::optional<FindingsTold> findings_told_;
  int64_t started_ns_ = 0;  // CLOCK_BOOTTIME
  WatchOptions watch_;
  // A tap reports.
  bool wire_visible_ = false;
  // Why the tap does not see what it should, as reported last.
  std::vector<std::string> wire_blind_;
  // There are participants with DDS Security that show us nothing.
  bool secured_hidden_ = false;
  // End of a renewed discovery; 0 = none is going on.
  int64_t resync_until_ns_ = 0;
  GraphLimitsWatch graph_limits_;
  GraphCounters graph_counted_;
  // Facts of discovery, in this turn.
  uint64_t facts_lost_ = 0;
  FlowCounters flow_counted_;

  // In this order: what calls back goes before what it uses.
  std::unique_ptr<Uplink> uplink_;
  std::unique_ptr<DomainWatch> domain_;  // null = see no_domain_
  // Null if it is not to announce, or may not.
  std::unique_ptr<dds::NodeAnnouncer> announcer_;
  bool announcing_ = true;  // the last claim was published
  // Null if there is no log to read.
  std::unique_ptr<IdsFeed> ids_;
  std::unique_ptr<wire::WireInput> wire_;  // null = without a tap
  std::thread observer_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_AGENT_H_
