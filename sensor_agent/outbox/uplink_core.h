// Decides what the sensor sends to the policy server, and when: keeps what was seen, sends it in
// batches, and goes on where it stopped when the stream comes back.
//
//   down ──began──► resuming ──config, credit and an ack per lane──► streaming
//     ▲──────────────────┴────────────────── ended ──────────────────────┘
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
// What is not live any more (older than `live`, unsent; or the outbox has no room) is set aside in
// the backlog, which goes to disk if there is much of it. After an outage its control observations
// go first; then what is live; and of the credit the backlog leaves at least half, at a rate of its
// own (send_session.h). What is unacknowledged when the process stops goes to disk, and the next
// process sends it.
//
// Pure: no thread, clock, file or wire. Used by one thread at a time; only Turn, and the results of
// its actions, give actions that send.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_UPLINK_CORE_H_
#define RIPS_SENSOR_AGENT_OUTBOX_UPLINK_CORE_H_

#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "absl/time/time.h"
#include "sensor_agent/outbox/send_session.h"
#include "sensor_agent/outbox/sensor_status.h"
#include "sensor_agent/outbox/uplink_io.h"
#include "services/base/clock.h"
#include "services/model/heartbeat.h"

namespace rips::sensor {

struct UplinkCoreOptions {
  OutboxLimits outbox;
  BacklogOptions backlog;
  uint64_t backlog_bytes_per_second = 512 * 1024;
  // What waits longer to be sent is not live any more.
  absl::Duration live = absl::Seconds(2);
  // Until the server sets another interval. Losses and the sensor's own state are looked at as
  // often.
  absl::Duration heartbeat = absl::Nanoseconds(model::kHeartbeatNs);
};

class UplinkCore {
 public:
  enum class Phase { kDown, kResuming, kStreaming };

  // Incarnations are 16 random bytes each: of what is live, and of what is set aside.
  UplinkCore(const UplinkCoreOptions& options, std::string incarnation,
             std::string backlog_incarnation);

  UplinkActions On(UplinkInput input, Instant now);
  // See Backlog::SetDisk.
  void SetDisk(const Backlog::Disk& disk) { kept_.backlog.SetDisk(disk); }

  Phase phase() const { return phase_; }
  const std::string& incarnation() const { return incarnation_; }
  const Outbox& outbox() const { return kept_.outbox; }
  const Backlog& backlog() const { return kept_.backlog; }
  const SensorStatus& status() const { return status_; }
  // After Stopping: everything is on disk, or the disk refuses.
  bool drained() const { return stopping_ && !kept_.backlog.writing(); }

 private:
  // What the server must say before batches flow.
  struct Resume {
    bool config = false;
    bool credit = false;
    bool ack[2] = {false, false};
    bool wants_snapshot = false;

    bool complete() const { return config && credit && ack[0] && ack[1]; }
  };
  struct Interval {
    int64_t length_ns = 0;
    int64_t last_ns = 0;

    int64_t next_ns() const { return last_ns + length_ns; }
    // True if it has passed; then the next one begins.
    bool Pass(int64_t now_ns) {
      if (now_ns < next_ns()) return false;
      last_ns = now_ns;
      return true;
    }
  };
  struct Handler;

  void Append(Observations observations, int64_t now_ns, UplinkActions& actions);
  void BeginStream(std::string fresh_incarnation, UplinkActions& actions);
  void EndStream(const absl::Status& why, int64_t now_ns, UplinkActions& actions);
  void OnAck(const AckReceived& ack, int64_t now_ns, UplinkActions& actions);
  void FinishResume(int64_t now_ns, UplinkActions& actions);
  void Close(std::string why, UplinkActions& actions);
  void Heartbeat(int64_t now_ns, UplinkActions& actions);
  // The next step of a turn: sending, then setting aside.
  void Continue(int64_t now_ns, UplinkActions& actions);
  void SetAsideNext(int64_t now_ns, UplinkActions& actions);
  void Stop(int64_t now_ns, UplinkActions& actions);
  std::vector<AnnouncedRange> Announce();
  void MergeLosses();
  bool OutboxIsFull() const;
  int64_t NextWake(int64_t now_ns) const;

  Kept kept_;
  SensorStatus status_;
  std::string incarnation_;
  Phase phase_ = Phase::kDown;
  Resume resume_;
  // Of the stream there is.
  std::optional<SendSession> session_;
  // Streams refused in a row without a new acknowledgement.
  int refusals_ = 0;
  // The highest that a server has reported durable, of what was announced last.
  std::map<StreamKey, uint64_t> acknowledged_;
  uint64_t server_boottime_ns_ = 0;
  // For losses and for the sensor's own state.
  Interval look_;
  // As often as this stream carries one.
  Interval heartbeat_;
  // Batches that may still be set aside in this turn.
  int set_aside_left_ = 0;
  // Something has come since the last turn that asks for another one at once.
  bool hurry_ = false;
  bool stopping_ = false;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_UPLINK_CORE_H_
