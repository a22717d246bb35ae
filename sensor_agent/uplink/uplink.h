// The sensor's stream to the policy server: keeps what was seen in an outbox, sends it in batches,
// and goes on where it stopped when the stream comes back.
//
//   down ──connected──► resuming ──config, credit and an ack per lane──► streaming
//     ▲─────────────────────┴──────────────── stream ended ─────────────────┘
//
// While resuming only heartbeats are sent. What the server needs to go on:
//
// | the server ...                                    | then the next stream ...              |
// |---------------------------------------------------|---------------------------------------|
// | goes on from its graph                            | resends what is unacknowledged        |
// | wants a snapshot, or acknowledged less than ever  | begins with a snapshot, unless the    |
// |                                                   | first graph step held is one          |
// | refused the last stream (INVALID_ARGUMENT)        | begins with a snapshot                |
// | did so twice, acknowledging nothing in between    | is of a new incarnation               |
// | did so twice with batches of the backlog underway | leaves the oldest of them out: lost   |
//
// A payload of more than 64 KiB goes in chunks ahead of the batch that names it, one payload at a
// time:
//
//   none ──its message is next to be sent──► chunks ──all are sent──► its batch ──► none
//                                              │
//                                              └─ not all sent in `live` / 2: shed ──► none
//
// Everything else goes before chunks that are not yet written, but for the batch that names them,
// which waits until they are. While they wait for credit or for the line, nothing else of the
// message lane is sent.
//
// What is not live any more (older than 2 s, unsent; or the outbox has no room) is set aside in a
// backlog, on disk if there is much of it. After an outage its control observations go first; then
// what is live; and of the credit the backlog leaves at least half, at a rate of its own. What it
// holds when the process ends in order goes to disk, with all that is unacknowledged, and the next
// process sends it.
//
// Threads: one sender thread; the client's session thread calls back. One mutex guards all state;
// it is held while a message is handed to the client's queue (which does not block), so that a
// batch cannot slip into a stream it was not made for. Lock order: ours, then the client's or the
// backlog's.
#ifndef RIPS_SENSOR_AGENT_UPLINK_UPLINK_H_
#define RIPS_SENSOR_AGENT_UPLINK_UPLINK_H_

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "rips/v1/sensor.pb.h"
#include "sensor_agent/interest/interest.h"
#include "sensor_agent/outbox/observation.h"
#include "sensor_agent/outbox/outbox.h"
#include "sensor_agent/spool/backlog.h"
#include "sensor_agent/uplink/uplink_options.h"
#include "sensor_agent/uplink/uplink_stream.h"
#include "sensor_agent/uplink/wire_encoder.h"
#include "services/base/clock.h"
#include "services/ros2/guid.h"
#include "services/rpc/bidi_client.h"
#include "services/runtime/metrics.h"
#include "services/runtime/mutex.h"

namespace rips::sensor {

class Uplink {
 public:
  // Called on the session thread without locks held; return soon.
  struct Hooks {
    std::function<void(std::vector<ros2::Guid>)> on_own_participants;
    // Full names of the parts whose modes are RIPS's to set. Told after the participants.
    std::function<void(std::vector<std::string>)> on_protected_parts;
    // Call ReplaceGraph soon: nothing is sent until then.
    std::function<void()> on_snapshot_wanted;
    // The server has forgotten what it acknowledged: append what stands again. The graph is taken
    // care of. May be empty.
    std::function<void()> on_server_forgot;
    // What to watch has changed. Call InterestInUse when it is observed.
    std::function<void(std::shared_ptr<const Interest>)> on_interest;
    // Graph and messages are this host's to report, or not. May be empty.
    std::function<void(bool)> on_primary;
  };

  // `clock` and `metrics` are not owned and outlive this.
  Uplink(UplinkOptions options, Hooks hooks, const Clock* clock, Metrics* metrics);
  ~Uplink();

  // Takes the backlog's directory, before Start. FailedPrecondition: another process has it.
  absl::Status Open() { return backlog_.Open(); }
  // Once each. Append may be called before Start: the outbox keeps. Stop writes what is not
  // acknowledged to the backlog's directory, if there is one.
  void Start();
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);

  // Any thread.
  void Append(Observations observations) ABSL_LOCKS_EXCLUDED(mu_);
  bool snapshot_wanted() const ABSL_LOCKS_EXCLUDED(mu_);
  // The whole graph, as Outbox::ReplaceGraph takes it.
  void ReplaceGraph(std::vector<GraphChange> snapshot) ABSL_LOCKS_EXCLUDED(mu_);
  // The interest of this id is observed from now on: the server is told, now or in the next hello.
  void InterestInUse(const std::string& id) ABSL_LOCKS_EXCLUDED(mu_);
  // This sensor on the bus, for the next hello; none() = not known.
  void SetParticipant(const ros2::Guid& participant) ABSL_LOCKS_EXCLUDED(mu_);
  // Whether this kind of traffic is visible from now on: the server is told, now or in the next
  // hello.
  void SetKindVisible(const std::string& kind, bool visible) ABSL_LOCKS_EXCLUDED(mu_);
  // Why what `input` stands for is not seen, for people; empty = it is. While there is a reason the
  // server holds its evidence for incomplete. Told as kinds are. `input` is "ids", "wire", "graph".
  void SetBlind(const std::string& input, std::vector<std::string> reasons)
      ABSL_LOCKS_EXCLUDED(mu_);
  // OK while streaming; otherwise an error with the reason, and how much waits.
  absl::Status Ready() const ABSL_LOCKS_EXCLUDED(mu_);
  // Of the alerts of the IDS that were appended, how many are acknowledged or in the backlog.
  uint64_t acknowledged_ids_alerts() const ABSL_LOCKS_EXCLUDED(mu_);
  // 16 bytes.
  std::string incarnation() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  using Client = rpc::BidiClient<rips::v1::SensorMessage, rips::v1::SensorReply>;
  enum class Phase { kDown, kResuming, kStreaming };

  std::unique_ptr<Client> MakeClient();
  rips::v1::SensorMessage OnConnected() ABSL_LOCKS_EXCLUDED(mu_);
  void OnMessage(const rips::v1::SensorReply& reply) ABSL_LOCKS_EXCLUDED(mu_);
  void OnDisconnected(const grpc::Status& status, rpc::CloseClass close_class)
      ABSL_LOCKS_EXCLUDED(mu_);

  void OnInterest(const rips::v1::Interest& wire) ABSL_LOCKS_EXCLUDED(mu_);
  // `problem` empty = in use.
  void AnswerInterestLocked(const std::string& id, const std::string& problem)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void OnConfigLocked(const rips::v1::SensorConfig& config) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Writes down what the server's store holds, if that has changed. On the session thread, or when
  // there is none.
  void KeepStorePoint() ABSL_LOCKS_EXCLUDED(mu_);
  void NoteAcknowledgedLocked(const StreamKey& stream, uint64_t sequence)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void OnAckLocked(const rips::v1::Ack& ack) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Resuming -> streaming, when everything has been said.
  // True if the server has forgotten what it acknowledged.
  bool FinishResumeLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void WantSnapshotLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Ends this stream and begins another.
  void ReopenLocked(const std::string& why) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  void HeartbeatLocked(Instant now) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void SendAnswersLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void ReportStateLocked(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void PumpLocked(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // False if nothing more of the lane can be sent now.
  bool SendBatchLocked(Lane lane, int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // All of the lane that is due.
  void SendDueLocked(Lane lane, int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // uplink_payloads.cc
  void BeginUploadLocked(PayloadUpload upload, int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Sends what may be sent of the upload, and the batch behind it. False: it waits.
  bool AdvanceUploadLocked(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // So many chunks are not yet written, or more; then what is written wakes us.
  bool LineHoldsLocked(size_t chunks) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // False: it waits for credit, or for the line.
  bool SendChunkLocked(PayloadUpload& upload) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The line did not carry the payload in time: its message goes without.
  void GiveUpUploadLocked(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // The batch of the backlog whose payload has gone out, or was given up. False: it waits.
  bool SendUploadedBacklogLocked(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Sheds payloads of messages that waited longer than `live` / 2 on a line that works, or of all
  // that wait: where it is too slow for payloads, metadata stays live.
  void ShedLatePayloadsLocked(int64_t now_ns, bool all) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // On the client's writer thread.
  void OnWritten() ABSL_LOCKS_EXCLUDED(mu_);
  void AnnounceLocked(rips::v1::SensorHello& hello) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // uplink_backlog.cc
  // When the backlog may send next, if it has something to send; nullopt = when it wakes us.
  std::optional<int64_t> BacklogDueLocked(int64_t now_ns) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // One batch, if one is due. False if none was sent.
  bool SendBacklogLocked(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Its observations, with the names they bring. False: it makes no sense, and is discarded.
  bool ParseBacklogBatchLocked(const BacklogBatch& next, rips::v1::ObservationBatch& batch)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Puts the parsed batch into this stream's names. False: it cannot be sent.
  bool MakeBacklogBatchLocked(const BacklogBatch& next, rips::v1::ObservationBatch& batch)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Begins the upload of the batch's payload that is too long to go inline. False: it has none.
  bool UploadOfBacklogLocked(const BacklogBatch& next, rips::v1::ObservationBatch& batch,
                             int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void SendBacklogBatchLocked(const BacklogBatch& next, rips::v1::ObservationBatch batch,
                              int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // Moves what is not live any more to the backlog, some of it at a time. True: there is more.
  bool SetAsideLocked(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool OutboxIsFullLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void LookAtBacklogLocked(int64_t now_ns) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  std::vector<std::string> BlindLocked() const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  std::optional<int64_t> OldestUnackedLocked(const BacklogState& backlog) const
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void SaveRest() ABSL_LOCKS_EXCLUDED(mu_);
  bool SendLocked(rips::v1::SensorMessage message) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  bool HasCreditLocked(Lane lane) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  int64_t NextWakeLocked(int64_t now_ns) const ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  void WakeLocked() ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  const UplinkOptions options_;
  const Hooks hooks_;
  const Clock* clock_;
  Counter batches_;
  Counter observations_sent_;
  Counter reconnects_;
  Counter shed_;
  Counter payloads_shed_;
  Counter payload_bytes_;
  Counter spool_unreadable_;
  Gauge outbox_bytes_;
  Gauge backlog_bytes_;
  Gauge spool_bytes_;
  Gauge spool_refuses_;
  Gauge oldest_unacked_;
  Gauge streaming_;
  Gauge blind_reasons_;

  mutable Mutex mu_;
  CondVar wake_cond_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  bool wake_ ABSL_GUARDED_BY(mu_) = false;
  bool reopen_ ABSL_GUARDED_BY(mu_) = false;
  // When the sender thread wakes by itself.
  int64_t next_wake_ns_ ABSL_GUARDED_BY(mu_) = 0;
  Phase phase_ ABSL_GUARDED_BY(mu_) = Phase::kDown;
  absl::Status down_because_ ABSL_GUARDED_BY(mu_);
  // Why there is no stream, as last logged; none since the last one.
  std::optional<absl::StatusCode> logged_ ABSL_GUARDED_BY(mu_);
  std::string incarnation_ ABSL_GUARDED_BY(mu_);
  // The highest that a server has told is durable, of what was announced last.
  std::map<StreamKey, uint64_t> acknowledged_ ABSL_GUARDED_BY(mu_);
  // As told last, also to a former process; and as it stands in the file.
  rips::v1::StorePoint store_point_ ABSL_GUARDED_BY(mu_);
  std::string store_point_kept_ ABSL_GUARDED_BY(mu_);
  Outbox outbox_ ABSL_GUARDED_BY(mu_);
  // Has a mutex of its own.
  Backlog backlog_;
  // When messages were released; what was received before then is not older for it.
  int64_t released_ns_ ABSL_GUARDED_BY(mu_) = 0;
  // The backlog's rate allows nothing before.
  int64_t backlog_next_ns_ ABSL_GUARDED_BY(mu_) = 0;
  std::optional<UplinkStream> stream_ ABSL_GUARDED_BY(mu_);
  BatchPolicy policy_ ABSL_GUARDED_BY(mu_);
  std::vector<ros2::Guid> own_participants_ ABSL_GUARDED_BY(mu_);
  // Streams refused in a row without a new acknowledgement.
  int refusals_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t server_boottime_ns_ ABSL_GUARDED_BY(mu_) = 0;
  int64_t last_heartbeat_ns_ ABSL_GUARDED_BY(mu_) = 0;
  bool had_backlog_ ABSL_GUARDED_BY(mu_) = false;
  bool overloaded_ ABSL_GUARDED_BY(mu_) = false;
  std::vector<std::string> not_visible_ ABSL_GUARDED_BY(mu_) = {kUnicastOnlyWriters,
                                                                kServiceRequests, kSharedMemory};
  std::vector<std::string> not_visible_told_ ABSL_GUARDED_BY(mu_);
  // By input; none is without a reason.
  std::map<std::string, std::vector<std::string>> blind_ ABSL_GUARDED_BY(mu_);
  std::vector<std::string> blind_told_ ABSL_GUARDED_BY(mu_);
  uint64_t shed_reported_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t unreadable_reported_ ABSL_GUARDED_BY(mu_) = 0;
  uint64_t payloads_shed_reported_ ABSL_GUARDED_BY(mu_) = 0;
  // Ids of the interest that is observed, and of the newest one handed on; empty = none yet. They
  // outlive streams, so that watching goes on while the server is away.
  std::string interest_in_use_ ABSL_GUARDED_BY(mu_);
  ros2::Guid participant_ ABSL_GUARDED_BY(mu_);
  std::string interest_handed_on_ ABSL_GUARDED_BY(mu_);
  // Asked to go there first.
  std::string redirect_ ABSL_GUARDED_BY(mu_);

  // The sender waits for something to be written.
  std::atomic<bool> waits_for_line_ = false;

  // Replaced by the sender thread only, while the old one is stopped.
  std::unique_ptr<Client> client_;
  bool stopped_ = false;
  std::thread sender_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_UPLINK_UPLINK_H_
