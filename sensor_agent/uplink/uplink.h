// The sensor's stream to the policy server. UplinkCore (outbox/uplink_core.h) decides what goes
// when; this performs it: one gRPC client, the encoder of the stream there is, the spool.
//
// Threads: one sender thread, which encodes; the client's session and writer threads and the
// spool's thread call back. One mutex guards all state; it is held while a message is handed to the
// client's queue (which does not block), so that a batch cannot slip into a stream it was not made
// for. Lock order: ours, then the client's, the spool thread's, or the store point's.
#ifndef RIPS_SENSOR_AGENT_UPLINK_UPLINK_H_
#define RIPS_SENSOR_AGENT_UPLINK_UPLINK_H_

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
#include "rips/v1/sensor.pb.h"
#include "sensor_agent/interest/interest.h"
#include "sensor_agent/outbox/uplink_core.h"
#include "sensor_agent/spool/spool_thread.h"
#include "sensor_agent/uplink/batch_writer.h"
#include "sensor_agent/uplink/interest_exchange.h"
#include "sensor_agent/uplink/store_file.h"
#include "sensor_agent/uplink/uplink_metrics.h"
#include "sensor_agent/uplink/uplink_options.h"
#include "services/base/clock.h"
#include "services/ros2/guid.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

class Uplink {
 public:
  // Called without locks held, on a thread of the client, the spool or the caller; return soon.
  struct Hooks {
    std::function<void(std::vector<ros2::Guid>)> on_own_participants;
    // Full names of the parts whose modes are RIPS's to set. Called after on_own_participants.
    std::function<void(std::vector<std::string>)> on_protected_parts;
    // Call ReplaceGraph soon: nothing is sent until then.
    std::function<void()> on_snapshot_wanted;
    // The server has forgotten what it acknowledged: append what stands again, but for the graph.
    // May be empty.
    std::function<void()> on_server_forgot;
    // What to watch has changed. Call InterestInUse when it is observed.
    std::function<void(std::shared_ptr<const Interest>)> on_interest;
    // Graph and messages are this host's to report, or not. May be empty.
    std::function<void(bool)> on_primary;
    // What the inventory sets of the sensor's configuration; each time that the server says it. May
    // be empty.
    std::function<void(std::vector<ConfigSetting>)> on_settings;
  };

  // `clock` and `metrics` are not owned and outlive this.
  Uplink(UplinkOptions options, Hooks hooks, const Clock* clock, Metrics* metrics);
  ~Uplink();

  // Opens the spool's directory, before Start. FailedPrecondition: another process has it. Any
  // other trouble is logged, and memory must do.
  absl::Status Open() ABSL_LOCKS_EXCLUDED(mu_);
  // Once each. Append may be called before Start: the outbox keeps. Stop writes what is not
  // acknowledged to the spool, if there is one.
  void Start();
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  // Any thread.
  void Append(Observations observations) ABSL_LOCKS_EXCLUDED(mu_);
  bool snapshot_wanted() const ABSL_LOCKS_EXCLUDED(mu_);
  // The whole graph, as Outbox::ReplaceGraph takes it.
  void ReplaceGraph(std::vector<GraphChange> snapshot) ABSL_LOCKS_EXCLUDED(mu_);
  // The interest of this id is observed from now on. The server learns it now or in the next hello,
  // as it learns what follows.
  void InterestInUse(const std::string& id) ABSL_LOCKS_EXCLUDED(mu_);
  // This sensor on the bus, for the next hello; none() = not known.
  void SetParticipant(const ros2::Guid& participant) ABSL_LOCKS_EXCLUDED(mu_);
  // As UplinkOptions has it from now on; a stream there is ends, and the next one says it.
  void SayConfiguration(const std::vector<ConfigSetting>& settings,
                        const std::vector<std::string>& refused) ABSL_LOCKS_EXCLUDED(mu_);
  // Whether this kind of traffic is visible from now on.
  void SetKindVisible(const std::string& kind, bool visible) ABSL_LOCKS_EXCLUDED(mu_);
  // Why what `input` ("ids", "wire", "graph") stands for is not seen, human-readable; empty = it
  // is. While there is a reason the server holds its evidence for incomplete.
  void SetBlind(const std::string& input, std::vector<std::string> reasons)
      ABSL_LOCKS_EXCLUDED(mu_);
  // OK while streaming; otherwise an error with the reason, and how much waits.
  absl::Status Ready() const ABSL_LOCKS_EXCLUDED(mu_);
  // Of the alerts of the IDS that were appended, how many are acknowledged or in the backlog.
  uint64_t acknowledged_ids_alerts() const ABSL_LOCKS_EXCLUDED(mu_);
  // 16 bytes.
  std::string incarnation() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  // What an input leaves to be done once the lock is released, and the hello of a new stream.
  struct Outcome {
    bool want_graph = false;
    bool server_forgot = false;
    std::optional<rips::v1::SensorMessage> hello;
  };
  struct Performer;

  std::unique_ptr<UplinkClient> MakeClient();
  rips::v1::SensorMessage OnConnected() ABSL_LOCKS_EXCLUDED(mu_);
  void OnMessage(const rips::v1::SensorReply& reply) ABSL_LOCKS_EXCLUDED(mu_);
  void OnConfig(const rips::v1::SensorConfig& config) ABSL_LOCKS_EXCLUDED(mu_);
  void OnInterest(const rips::v1::Interest& wire) ABSL_LOCKS_EXCLUDED(mu_);
  void OnDisconnected(const grpc::Status& status, rpc::CloseClass close_class)
      ABSL_LOCKS_EXCLUDED(mu_);
  // All chunks are written, on the client's writer thread.
  void OnWritten() ABSL_LOCKS_EXCLUDED(mu_);
  void OnSpoolResult(SpoolResult result) ABSL_LOCKS_EXCLUDED(mu_);

  // Hands the input to the core, and does what it wants.
  void Handle(UplinkInput input) ABSL_LOCKS_EXCLUDED(mu_);
  Outcome HandleLocked(UplinkInput input) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void CallHooks(const Outcome& outcome) ABSL_LOCKS_EXCLUDED(mu_);
  rips::v1::SensorMessage MakeHello(const SendHello& action, Instant now)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void SendAnswersLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // So many chunks are not yet written, or more; then LineFree follows.
  bool LineHoldsLocked(size_t chunks) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void StreamGoneLocked(const absl::Status& why) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ReopenLocked(const std::string& why) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void WakeLocked(int64_t at_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The sender thread.
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  void Recover() ABSL_LOCKS_EXCLUDED(mu_);

  const UplinkOptions options_;
  const Hooks hooks_;
  const Clock* clock_;
  StorePointKeeper store_;

  mutable Mutex mu_;
  // The sender has work, or the disk has done some.
  CondVar changed_;
  UplinkMetrics metrics_ ABSL_GUARDED_BY(mu_);
  UplinkCore core_ ABSL_GUARDED_BY(mu_);
  // When the sender thread wakes by itself.
  int64_t next_wake_ns_ ABSL_GUARDED_BY(mu_) = 0;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  // The sender is to replace the client.
  bool reopen_ ABSL_GUARDED_BY(mu_) = false;
  // To be connected to first, by the server's wish.
  std::string redirect_ ABSL_GUARDED_BY(mu_);
  absl::Status down_because_ ABSL_GUARDED_BY(mu_);
  // Why there is no stream, as last logged; none since the last one.
  std::optional<absl::StatusCode> logged_ ABSL_GUARDED_BY(mu_);
  // Of the stream there is.
  std::optional<BatchWriter> writer_ ABSL_GUARDED_BY(mu_);
  InterestExchange interest_ ABSL_GUARDED_BY(mu_);
  ros2::Guid participant_ ABSL_GUARDED_BY(mu_);
  rips::v1::Configuration configuration_ ABSL_GUARDED_BY(mu_);
  // LineFree is to follow.
  std::atomic<bool> waits_for_line_ = false;

  // Replaced by the sender thread only, while the old one is stopped.
  std::unique_ptr<UplinkClient> client_;
  bool stopped_ = false;
  std::thread sender_;
  // Null = memory only.
  std::unique_ptr<SpoolThread> spool_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_UPLINK_H_
