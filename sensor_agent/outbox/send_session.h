// One stream to the policy server once batches flow: what its credit lets us send, and in which
// order. Made anew for each stream.
//
// | turn     | sends                                                                  | then     |
// |----------|------------------------------------------------------------------------|----------|
// | backlog  | while a payload goes in chunks: control observations, its next chunk;  | control  |
// |          | else one batch of the backlog, control before messages, if its rate    |          |
// |          | and at least half of the credit are free                               |          |
// | control  | all live control observations that are due                             | messages |
// | messages | all live messages that are due; the payload of the next one if it must | backlog  |
// |          | go in chunks                                                           |          |
//
// It rests when a round of turns has sent nothing. While chunks wait for credit or for the line,
// nothing else of the message lane is sent.
#ifndef RIPS_SENSOR_AGENT_OUTBOX_SEND_SESSION_H_
#define RIPS_SENSOR_AGENT_OUTBOX_SEND_SESSION_H_

#include <cstdint>
#include <limits>
#include <optional>
#include <string>

#include "sensor_agent/outbox/backlog.h"
#include "sensor_agent/outbox/batch_planner.h"
#include "sensor_agent/outbox/outbox.h"
#include "sensor_agent/outbox/payload_upload.h"
#include "sensor_agent/outbox/uplink_io.h"

namespace rips::sensor {

// What is kept for the server, and outlives streams.
struct Kept {
  Outbox outbox;
  Backlog backlog;
  // By the messages in it since the last stream that carried batches: what came before may be
  // acknowledged, and the next server may hold none of it.
  GraphTrail::Brought brought = {};
  BatchPolicy policy = {};
  // What waits longer to be sent is not live any more.
  int64_t live_ns = 0;
  // Of the backlog, so that a server that comes back is not flooded by its robots.
  uint64_t backlog_bytes_per_second = 0;
  // When messages were released; what was received before then is not older for it.
  int64_t released_ns = 0;
  // The backlog's rate allows nothing before.
  int64_t backlog_next_ns = 0;
};

// Not thread-safe. Times are CLOCK_BOOTTIME in nanoseconds.
class SendSession {
 public:
  // `kept` is not owned and outlives this.
  explicit SendSession(Kept* kept) : kept_(*kept) {}
  // Batches flow from now on.
  void Begin(int64_t now_ns) { began_ns_ = now_ns; }

  StreamCredit messages;
  StreamCredit payloads;

  // The next action, which has a result; nullopt: nothing more can be sent now.
  std::optional<UplinkAction> Next(int64_t now_ns);
  void On(const BatchSent& result, int64_t now_ns);
  void On(const ChunkSent& result);
  void On(const ChunksTakenBack& result, int64_t now_ns);
  // nullopt, or why that batch of the backlog is lost.
  std::optional<BacklogLost> On(const BacklogOpened& result, int64_t now_ns);
  std::optional<BacklogLost> On(const BacklogSent& result, int64_t now_ns);
  void OnLineFree();

  // When Next can give something if nothing else happens; kNever = then it cannot.
  static constexpr int64_t kNever = std::numeric_limits<int64_t>::max();
  int64_t NextDue(int64_t now_ns) const;
  // The stream has no numbers left for new names.
  bool names_used_up() const { return names_used_up_; }
  // A live message's payload goes in chunks.
  bool uploading_live() const { return upload_.has_value() && !upload_->backlog.has_value(); }
  // Sheds payloads of messages that waited longer than `live` / 2 on a line that works, or of all
  // that wait: where it is too slow for payloads, metadata stays live.
  void ShedLatePayloads(int64_t now_ns, bool all);

 private:
  enum class Kind { kBacklog, kControl, kMessages };

  // When the next live batch of the lane should go; nullopt = there is none.
  std::optional<int64_t> LiveDue(Lane lane, int64_t now_ns) const;
  std::optional<UplinkAction> NextControl(int64_t now_ns);
  std::optional<UplinkAction> NextMessages(int64_t now_ns);
  std::optional<UplinkAction> NextUploaded(int64_t now_ns);
  std::optional<UplinkAction> NextOfBacklog(int64_t now_ns);
  std::optional<int64_t> BacklogDue(int64_t now_ns) const;
  void BeginUpload(PayloadUpload upload, int64_t now_ns);
  BacklogLost Lost(const BacklogBatch& batch, int64_t now_ns);

  Kept& kept_;
  int64_t began_ns_ = 0;
  BatchPlanner planner_;
  Kind turn_ = Kind::kBacklog;
  bool progress_ = false;
  // The line was full: nothing goes before.
  int64_t retry_ns_ = 0;
  Lane sending_ = Lane::kControl;
  int64_t last_batch_ns_[2] = {0, 0};
  // The grants with which nothing more, and the backlog's next batch, could not be sent.
  std::optional<uint64_t> exhausted_at_;
  std::optional<uint64_t> backlog_blocked_at_;
  std::optional<PayloadUpload> upload_;
  uint64_t last_payload_id_ = 0;
  // Asked to be opened, or open and to be sent.
  std::optional<BacklogBatch> opened_;
  std::optional<SendBacklog> ready_;
  bool names_used_up_ = false;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_OUTBOX_SEND_SESSION_H_
