#include "sensor_agent/uplink/uplink.h"

#include <algorithm>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "rips/v1/sensor.grpc.pb.h"
#include "sensor_agent/interest/interest_file.h"
#include "sensor_agent/uplink/store_file.h"
#include "services/base/check.h"
#include "services/base/ids.h"
#include "services/ros2/ros_name.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/log.h"
#include "services/wire_limits/field_limits.h"

namespace rips::sensor {

namespace {

using rips::v1::SensorMessage;
using rips::v1::SensorReply;

// Streams whose acknowledgements are remembered; a hello announces fewer.
constexpr size_t kAcknowledgedMax = 256;
constexpr uint32_t kProtocol = 1;
// Batches handed to the client and not yet written. Few: what waits there is in front of control
// observations that come later, and the outbox holds everything anyway.
constexpr size_t kClientQueue = 32;
// Answers to interests that wait for the client's queue.
constexpr size_t kAnswersMax = 16;
// Parts watched over; four actuators tell no more.
constexpr size_t kProtectedPartsMax = 1'024;
constexpr int64_t kStallRetryNs = 10 * kNanosPerMilli;
// What the server may set, whatever it says.
constexpr uint32_t kBatchObservationsMax = 256;
constexpr uint32_t kBatchBytesMin = 1024;
constexpr uint32_t kBatchBytesMax = 1 << 20;
constexpr uint32_t kLingerMsMax = 1000;
// After this many refused streams in a row the incarnation is given up.
constexpr int kRefusalsMax = 2;
constexpr Lane kLanes[] = {Lane::kControl, Lane::kMessages};

int Index(Lane lane) { return lane == Lane::kControl ? 0 : 1; }

std::string NewIncarnation() { return absl::HexStringToBytes(NewId()); }

// The valid ones.
std::vector<std::string> ProtectedParts(const rips::v1::SensorConfig& config) {
  std::vector<std::string> parts;
  for (const std::string& part : config.protected_parts()) {
    const absl::Status valid = parts.size() < kProtectedPartsMax
                                   ? ros2::ValidateNodeName(part)
                                   : absl::ResourceExhaustedError(absl::StrCat(
                                         "more than ", kProtectedPartsMax, " protected parts"));
    if (valid.ok()) {
      parts.push_back(part);
      continue;
    }
    LogWarning("cannot monitor a part", {{"error", valid.message()}});
    if (parts.size() >= kProtectedPartsMax) break;
  }
  return parts;
}

void SetClock(Instant now, rips::v1::Clock* clock) {
  clock->set_boottime_ns(static_cast<uint64_t>(now.boottime_ns));
  clock->set_unix_ns(now.unix_ns);
}

}  // namespace

Uplink::Uplink(UplinkOptions options, Hooks hooks, const Clock* clock, Metrics* metrics)
    : options_(std::move(options)),
      hooks_(std::move(hooks)),
      clock_(clock),
      batches_(metrics->AddCounter("rips_sensor_batches_total", "Batches handed to the stream")),
      observations_sent_(metrics->AddCounter("rips_sensor_observations_sent_total",
                                             "Observations sent, repeated ones included")),
      reconnects_(metrics->AddCounter("rips_sensor_stream_ends_total",
                                      "Streams and attempts to connect that ended")),
      shed_(metrics->AddCounter("rips_sensor_shed_total", "Messages shed by a full outbox")),
      payloads_shed_(metrics->AddCounter(
          "rips_sensor_payloads_shed_total",
          "Payloads that were asked for and not kept; their messages were, as metadata")),
      payload_bytes_(metrics->AddCounter("rips_sensor_payload_bytes_total",
                                         "Bytes of payloads above 64 KiB sent in chunks")),
      spool_unreadable_(metrics->AddCounter("rips_sensor_spool_lost_total",
                                            "Observations that the spool could not give back")),
      outbox_bytes_(metrics->AddGauge("rips_sensor_outbox_bytes",
                                      "Estimated memory of observations not acknowledged")),
      backlog_bytes_(metrics->AddGauge("rips_sensor_backlog_bytes",
                                       "Memory of observations set aside, in part on disk, too")),
      spool_bytes_(metrics->AddGauge("rips_sensor_spool_bytes",
                                     "Observations on disk that are not acknowledged, bytes")),
      spool_refuses_(metrics->AddGauge("rips_sensor_spool_refuses",
                                       "1 while the disk does not take what should be spooled")),
      oldest_unacked_(metrics->AddGauge("rips_sensor_oldest_unacked_seconds",
                                        "Age of the oldest observation not acknowledged")),
      streaming_(metrics->AddGauge("rips_sensor_streaming", "1 while the stream carries batches")),
      blind_reasons_(
          metrics->AddGauge("rips_sensor_blind_reasons", "Configured inputs that are not seen")),
      down_because_(absl::UnavailableError("not connected yet")),
      incarnation_(NewIncarnation()),
      outbox_(options_.outbox),
      backlog_(options_.backlog, NewIncarnation(), clock, [this] {
        MutexLock lock(&mu_);
        WakeLocked();
      }) {}

Uplink::~Uplink() { Stop(); }

std::unique_ptr<Uplink::Client> Uplink::MakeClient() {
  rpc::BidiClientOptions options{.servers = options_.servers,
                                 .credentials = options_.credentials,
                                 .on_peer = options_.on_peer,
                                 .backoff = options_.backoff,
                                 .queue_capacity = kClientQueue};
  {
    MutexLock lock(&mu_);
    if (!redirect_.empty()) options.servers.insert(options.servers.begin(), redirect_);
    redirect_.clear();
  }
  return std::make_unique<Client>(
      std::move(options),
      Client::Callbacks{
          .start_stream =
              [](const std::shared_ptr<grpc::Channel>& channel, grpc::ClientContext* context) {
                return std::unique_ptr<Client::Stream>(
                    rips::v1::SensorService::NewStub(channel)->Observe(context));
              },
          .on_connected = [this] { return OnConnected(); },
          .on_message = [this](const SensorReply& reply) { OnMessage(reply); },
          .on_disconnected =
              [this](const grpc::Status& status, rpc::CloseClass close_class) {
                OnDisconnected(status, close_class);
              },
          .on_bulk_written = [this] { OnWritten(); }});
}

void Uplink::Start() {
  RIPS_CHECK(client_ == nullptr, "an uplink starts once");
  if (!options_.store_file.empty()) {
    absl::StatusOr<rips::v1::StorePoint> kept = LoadStorePoint(options_.store_file);
    MutexLock lock(&mu_);
    if (kept.ok()) {
      store_point_ = *std::move(kept);
      store_point_kept_ = store_point_.SerializeAsString();
    } else if (!absl::IsNotFound(kept.status())) {
      LogWarning("cannot use the store position saved by the last run",
                 {{"file", options_.store_file}, {"error", kept.status().ToString()}});
    }
  }
  backlog_.Start();
  client_ = MakeClient();
  sender_ = std::thread([this] { Run(); });
}

void Uplink::Stop() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    WakeLocked();
  }
  if (sender_.joinable()) sender_.join();
  if (client_ == nullptr || std::exchange(stopped_, true)) return;
  client_->Stop();
  KeepStorePoint();
  if (backlog_.on_disk()) SaveRest();
  const uint64_t left = backlog_.Stop();
  if (left > 0) {
    LogError(
        "no disk space for the spool; unacknowledged observations are lost when the sensor stops",
        {{"observations", left}});
  }
}

// --- Filling

void Uplink::Append(Observations observations) {
  const int64_t now_ns = clock_->Now().boottime_ns;
  bool snapshot_wanted = false;
  {
    MutexLock lock(&mu_);
    for (GraphChange& change : observations.graph) outbox_.AddGraph(std::move(change), now_ns);
    for (MessageSeen& message : observations.messages) outbox_.AddMessage(std::move(message));
    for (Loss& loss : observations.losses) outbox_.AddLoss(std::move(loss));
    for (const std::string& signal : observations.signals) outbox_.AddSignal(signal, now_ns);
    for (ControlObservation& alert : observations.ids_alerts) outbox_.AddControl(std::move(alert));
    for (ControlObservation& finding : observations.findings) {
      outbox_.AddControl(std::move(finding));
    }
    if (observations.settled && !outbox_.messages_released()) {
      outbox_.ReleaseMessages();
      released_ns_ = now_ns;
    }
    snapshot_wanted = outbox_.snapshot_wanted();
    if (OutboxIsFullLocked() || NextWakeLocked(now_ns) < next_wake_ns_) WakeLocked();
  }
  if (snapshot_wanted) hooks_.on_snapshot_wanted();
}

bool Uplink::snapshot_wanted() const {
  MutexLock lock(&mu_);
  return outbox_.snapshot_wanted();
}

void Uplink::ReplaceGraph(std::vector<GraphChange> snapshot) {
  MutexLock lock(&mu_);
  outbox_.ReplaceGraph(std::move(snapshot), clock_->Now().boottime_ns);
  WakeLocked();
}

void Uplink::SetKindVisible(const std::string& kind, bool visible) {
  MutexLock lock(&mu_);
  const auto it = std::find(not_visible_.begin(), not_visible_.end(), kind);
  if (visible && it != not_visible_.end()) not_visible_.erase(it);
  if (!visible && it == not_visible_.end()) not_visible_.push_back(kind);
}

void Uplink::SetBlind(const std::string& input, std::vector<std::string> reasons) {
  for (std::string& reason : reasons) reason = ros2::Printable(reason);
  MutexLock lock(&mu_);
  if (reasons.empty()) {
    blind_.erase(input);
  } else {
    blind_[input] = std::move(reasons);
  }
  blind_reasons_.Set(static_cast<double>(BlindLocked().size()));
}

std::vector<std::string> Uplink::BlindLocked() const {
  std::vector<std::string> all;
  for (const auto& [input, reasons] : blind_) {
    all.insert(all.end(), reasons.begin(), reasons.end());
  }
  return all;
}

absl::Status Uplink::Ready() const {
  MutexLock lock(&mu_);
  if (phase_ == Phase::kStreaming) return absl::OkStatus();
  const BacklogState backlog = backlog_.state();
  const std::string held = absl::StrCat("; ", outbox_.bytes() + backlog.memory_bytes,
                                        " bytes wait in memory, ", backlog.disk_bytes, " on disk");
  if (phase_ == Phase::kResuming) return absl::UnavailableError("connected, resuming" + held);
  return absl::Status(down_because_.code(), absl::StrCat(down_because_.message(), held));
}

uint64_t Uplink::acknowledged_ids_alerts() const {
  MutexLock lock(&mu_);
  return outbox_.acknowledged_ids_alerts();
}

std::string Uplink::incarnation() const {
  MutexLock lock(&mu_);
  return incarnation_;
}

// --- The client's callbacks

SensorMessage Uplink::OnConnected() {
  const Instant now = clock_->Now();
  MutexLock lock(&mu_);
  if (refusals_ >= kRefusalsMax) {
    LogWarning("server rejected this incarnation; starting a new one");
    refusals_ = 0;
    incarnation_ = NewIncarnation();
    outbox_.Renumber();
  }
  outbox_.Rewind();
  stream_.emplace(incarnation_, options_.encoder);
  phase_ = Phase::kResuming;
  SensorMessage message;
  rips::v1::SensorHello* sensor = message.mutable_hello();
  rips::v1::Hello* hello = sensor->mutable_hello();
  hello->set_protocol(kProtocol);
  hello->set_version(std::string(RipsVersion()));
  hello->set_incarnation(incarnation_);
  hello->set_host(options_.host);
  SetClock(now, hello->mutable_clock());
  sensor->set_domain(options_.domain);
  if (!participant_.none()) sensor->set_participant_guid(participant_.ToBytes());
  sensor->set_interest_in_use(interest_in_use_);
  if (!store_point_.generation().empty()) *sensor->mutable_store() = store_point_;
  for (const std::string& kind : not_visible_) sensor->add_not_visible(kind);
  not_visible_told_ = not_visible_;
  blind_told_ = BlindLocked();
  for (const std::string& reason : blind_told_) sensor->add_blind(reason);
  AnnounceLocked(*sensor);
  wire_limits::CutToLimits(message);
  WakeLocked();
  return message;
}

void Uplink::OnMessage(const SensorReply& reply) {
  if (reply.has_interest()) return OnInterest(reply.interest());
  std::optional<std::vector<ros2::Guid>> own;
  bool snapshot_wanted = false;
  bool forgot = false;
  {
    MutexLock lock(&mu_);
    if (!stream_.has_value()) return;
    switch (reply.kind_case()) {
      case SensorReply::kConfig:
        OnConfigLocked(reply.config());
        own = own_participants_;
        break;
      case SensorReply::kAck:
        OnAckLocked(reply.ack());
        break;
      case SensorReply::kCredit:
        stream_->has_credit = true;
        stream_->credit_granted = std::max(stream_->credit_granted, reply.credit().message_bytes());
        stream_->credit_window =
            std::max(stream_->credit_window, stream_->credit_granted - stream_->credit_used);
        stream_->payload_granted =
            std::max(stream_->payload_granted, reply.credit().payload_bytes());
        stream_->payload_window =
            std::max(stream_->payload_window, stream_->payload_granted - stream_->payload_used);
        break;
      case SensorReply::kHeartbeat:
        server_boottime_ns_ =
            std::max(server_boottime_ns_, reply.heartbeat().clock().boottime_ns());
        return;
      case SensorReply::kRedirect:
        redirect_ = reply.redirect().target();
        ReopenLocked("redirected");
        break;
      case SensorReply::kInterest:  // above
      case SensorReply::KIND_NOT_SET:
        return;  // of a later version
    }
    forgot = FinishResumeLocked();
    snapshot_wanted = phase_ == Phase::kStreaming && outbox_.snapshot_wanted();
    WakeLocked();
  }
  if (own.has_value()) {
    hooks_.on_own_participants(*std::move(own));
    if (hooks_.on_protected_parts) hooks_.on_protected_parts(ProtectedParts(reply.config()));
  }
  if (reply.has_config()) KeepStorePoint();
  if (reply.has_config() && hooks_.on_primary) hooks_.on_primary(reply.config().primary());
  if (forgot && hooks_.on_server_forgot) hooks_.on_server_forgot();
  if (snapshot_wanted) hooks_.on_snapshot_wanted();
}

void Uplink::OnConfigLocked(const rips::v1::SensorConfig& config) {
  stream_->has_config = true;
  policy_.observations = std::clamp(config.batch_observations(), 1u, kBatchObservationsMax);
  policy_.bytes = std::clamp(config.batch_bytes(), kBatchBytesMin, kBatchBytesMax);
  policy_.linger_ns = std::min(config.linger_ms(), kLingerMsMax) * kNanosPerMilli;
  own_participants_.clear();
  for (const std::string& bytes : config.own_participants()) {
    const absl::StatusOr<ros2::Guid> guid = ros2::GuidFromBytes(bytes);
    if (guid.ok()) {
      own_participants_.push_back(*guid);
    } else {
      LogWarning("server sent a malformed participant", {{"error", guid.status().message()}});
    }
  }
  if (config.store().generation().size() == kGenerationBytes) {
    store_point_ = config.store();
  } else if (config.has_store()) {
    LogWarning("server sent a malformed store generation");
  }
  outbox_.SetPrimary(config.primary());
  stream_->wants_snapshot |= config.want_snapshot();
}

// Called when a stream begins and when it has ended: a backup is restored while the server is
// stopped. In between the newest commit stands in memory alone; a disk is not written for each.
void Uplink::KeepStorePoint() {
  if (options_.store_file.empty()) return;
  rips::v1::StorePoint point;
  {
    MutexLock lock(&mu_);
    if (store_point_.generation().empty() ||
        store_point_.SerializeAsString() == store_point_kept_) {
      return;
    }
    point = store_point_;
  }
  if (absl::Status kept = SaveStorePoint(options_.store_file, point); !kept.ok()) {
    LogWarning("cannot save the server's store position", {{"error", kept.ToString()}});
    return;
  }
  MutexLock lock(&mu_);
  store_point_kept_ = point.SerializeAsString();
}

void Uplink::NoteAcknowledgedLocked(const StreamKey& stream, uint64_t sequence) {
  // Only of streams that the last hello announced; a server may not fill our memory.
  if (acknowledged_.size() >= kAcknowledgedMax && !acknowledged_.contains(stream)) return;
  uint64_t& known = acknowledged_[stream];
  known = std::max(known, sequence);
}

void Uplink::OnAckLocked(const rips::v1::Ack& ack) {
  if (ack.lane() != rips::v1::CONTROL && ack.lane() != rips::v1::MESSAGES) return;
  const Lane lane = ack.lane() == rips::v1::CONTROL ? Lane::kControl : Lane::kMessages;
  NoteAcknowledgedLocked({.incarnation = ack.incarnation(), .lane = lane}, ack.durable_sequence());
  store_point_.set_commit(std::max(store_point_.commit(), ack.commit()));
  if (ack.incarnation() != incarnation_) {
    const absl::Status taken = backlog_.Acknowledge(
        {.incarnation = ack.incarnation(), .lane = lane}, ack.durable_sequence());
    if (!taken.ok()) ReopenLocked(std::string(taken.message()));
    return;
  }
  const uint64_t before = outbox_.acknowledged(lane);
  const bool resuming = !stream_->has_ack[Index(lane)];
  stream_->has_ack[Index(lane)] = true;
  if (resuming && lane == Lane::kControl && ack.durable_sequence() < before) {
    stream_->wants_snapshot = true;  // the server has lost what it knew of us
  }
  if (phase_ == Phase::kStreaming && ack.durable_sequence() > before) refusals_ = 0;
  const absl::Status acknowledged = outbox_.Acknowledge(lane, ack.durable_sequence());
  if (!acknowledged.ok()) ReopenLocked(std::string(acknowledged.message()));
}

void Uplink::OnInterest(const rips::v1::Interest& wire) {
  {
    MutexLock lock(&mu_);
    if (wire.id() == interest_handed_on_) {
      // Told again. If it is not in use yet the answer comes when it is.
      if (wire.id() == interest_in_use_) AnswerInterestLocked(wire.id(), "");
      return;
    }
  }
  // Patterns take a while to compile: not under the lock.
  absl::StatusOr<std::shared_ptr<const Interest>> interest = InterestFromWire(wire);
  {
    MutexLock lock(&mu_);
    if (!interest.ok()) {
      const std::string problem = interest.status().ToString();
      LogWarning("interest rejected; keeping the previous one", {{"error", problem}});
      AnswerInterestLocked(wire.id(), problem);
      return;
    }
    interest_handed_on_ = wire.id();
  }
  if (!options_.interest_file.empty()) {
    if (absl::Status kept = SaveInterest(options_.interest_file, wire); !kept.ok()) {
      LogWarning("cannot save the interest for the next start", {{"error", kept.ToString()}});
    }
  }
  hooks_.on_interest(*std::move(interest));
}

void Uplink::SetParticipant(const ros2::Guid& participant) {
  MutexLock lock(&mu_);
  participant_ = participant;
}

void Uplink::InterestInUse(const std::string& id) {
  MutexLock lock(&mu_);
  interest_in_use_ = id;
  AnswerInterestLocked(id, "");
}

void Uplink::AnswerInterestLocked(const std::string& id, const std::string& problem) {
  if (!stream_.has_value()) return;  // the next hello says it
  if (stream_->answers.size() >= kAnswersMax) {
    LogDebug("interest reply dropped: the server does not read the stream");
    return;
  }
  rips::v1::InterestApplied& answer = stream_->answers.emplace_back();
  answer.set_interest(id);
  answer.set_problem(problem);
  wire_limits::CutToLimits(answer);
  WakeLocked();
}

bool Uplink::FinishResumeLocked() {
  if (phase_ == Phase::kDown) return false;
  if (phase_ == Phase::kResuming) {
    if (!stream_->has_config || !stream_->has_credit) return false;
    if (!stream_->has_ack[0] || !stream_->has_ack[1]) return false;
    phase_ = Phase::kStreaming;
    stream_->began_ns = clock_->Now().boottime_ns;
    logged_.reset();
    streaming_.Set(1);
    LogInfo("streaming", {{"unacked_bytes", outbox_.bytes()}});
    if (refusals_ > 0) outbox_.WantSnapshot();
  }
  const bool forgot = stream_->wants_snapshot && !outbox_.GraphStartsWithSnapshot();
  if (forgot && !outbox_.StartGraphWithSnapshot(clock_->Now().boottime_ns)) {
    outbox_.WantSnapshot();
  }
  stream_->wants_snapshot = false;
  return forgot;
}

void Uplink::ReopenLocked(const std::string& why) {
  LogWarning("reopening the stream", {{"reason", why}});
  phase_ = Phase::kDown;
  stream_.reset();
  down_because_ = absl::UnavailableError(why);
  streaming_.Set(0);
  reopen_ = true;
  WakeLocked();
}

void Uplink::OnDisconnected(const grpc::Status& status, rpc::CloseClass close_class) {
  reconnects_.Increment();
  const absl::Status why = rpc::FromGrpc(status);
  KeepStorePoint();
  MutexLock lock(&mu_);
  const bool news = logged_ != why.code();
  logged_ = why.code();
  phase_ = Phase::kDown;
  stream_.reset();
  streaming_.Set(0);
  if (absl::IsInvalidArgument(why)) {
    ++refusals_;
    backlog_.Refused(why);
  }
  down_because_ = why.ok() ? absl::UnavailableError("the server ended the stream") : why;
  // The same again and again is said once.
  Log(news ? LogLevel::kWarning : LogLevel::kDebug, "no stream to the policy server",
      {{"class", rpc::CloseClassName(close_class)}, {"error", down_because_.ToString()}});
}

// --- Sending

void Uplink::WakeLocked() {
  wake_ = true;
  wake_cond_.NotifyOne();
}

bool Uplink::SendLocked(SensorMessage message) { return client_->Send(std::move(message)); }

void Uplink::Run() {
  // Not before it is known what former processes left: the hello announces it.
  backlog_.WaitUntilRecovered();
  client_->Start();
  while (true) {
    bool reopen = false;
    {
      MutexLock lock(&mu_);
      Instant now = clock_->Now();
      next_wake_ns_ = NextWakeLocked(now.boottime_ns);
      while (!wake_ && !stopping_ && now.boottime_ns < next_wake_ns_) {
        wake_cond_.WaitUntil(lock, next_wake_ns_);
        now = clock_->Now();
      }
      if (stopping_) return;
      wake_ = false;
      next_wake_ns_ = 0;  // awake: nobody needs to wake us
      reopen = std::exchange(reopen_, false);
      if (!reopen) {
        HeartbeatLocked(now);
        SendAnswersLocked();
        if (phase_ == Phase::kStreaming) PumpLocked(now.boottime_ns);
        wake_ |= SetAsideLocked(now.boottime_ns);
      }
    }
    if (!reopen) continue;
    client_->Stop();
    client_ = MakeClient();
    client_->Start();
  }
}

void Uplink::HeartbeatLocked(Instant now) {
  if (now.boottime_ns < last_heartbeat_ns_ + absl::ToInt64Nanoseconds(options_.heartbeat)) return;
  last_heartbeat_ns_ = now.boottime_ns;
  LookAtBacklogLocked(now.boottime_ns);
  if (phase_ == Phase::kDown) return;
  SensorMessage message;
  SetClock(now, message.mutable_heartbeat()->mutable_clock());
  message.mutable_heartbeat()->set_echo_boottime_ns(server_boottime_ns_);
  if (!SendLocked(std::move(message)))
    LogDebug("heartbeat dropped: the server does not read the stream");
  if (phase_ == Phase::kStreaming) ReportStateLocked(now.boottime_ns);
}

void Uplink::SendAnswersLocked() {
  if (!stream_.has_value()) return;
  std::vector<rips::v1::InterestApplied>& answers = stream_->answers;
  while (!answers.empty()) {
    SensorMessage message;
    *message.mutable_interest_applied() = answers.front();
    if (!SendLocked(std::move(message))) return;  // at the next wake-up
    answers.erase(answers.begin());
  }
}

void Uplink::PumpLocked(int64_t now_ns) {
  if (stream_->stalled.has_value()) {
    if (!SendLocked(*stream_->stalled)) return;
    stream_->stalled.reset();
  }
  bool more = true;
  while (more) {
    if (stream_->upload.has_value()) {
      SendDueLocked(Lane::kControl, now_ns);
      if (!stream_.has_value() || stream_->stalled.has_value()) return;
      if (!AdvanceUploadLocked(now_ns)) return;
    }
    more = SendBacklogLocked(now_ns);
    if (!stream_.has_value() || stream_->stalled.has_value()) return;
    for (const Lane lane : kLanes) {
      if (stream_->upload.has_value()) break;
      SendDueLocked(lane, now_ns);
      if (!stream_.has_value() || stream_->stalled.has_value()) return;
    }
    more |= stream_->upload.has_value();
  }
}

void Uplink::SendDueLocked(Lane lane, int64_t now_ns) {
  while (stream_.has_value() && !stream_->stalled.has_value() &&
         outbox_.DueAt(lane, policy_, stream_->last_batch_ns[Index(lane)], now_ns) == now_ns) {
    if (!SendBatchLocked(lane, now_ns)) return;
  }
}

bool Uplink::SendBatchLocked(Lane lane, int64_t now_ns) {
  SentPayload sent;
  if (lane == Lane::kControl) {
    outbox_.FlushMerged(now_ns);
  } else {
    if (stream_->upload.has_value()) sent = stream_->upload->sent;
    Payload next = stream_->encoder.NextToChunk(outbox_, policy_);
    if (next != nullptr && next != sent.payload) {
      ShedLatePayloadsLocked(now_ns, /*all=*/false);
      next = stream_->encoder.NextToChunk(outbox_, policy_);
    }
    // What is before it goes first: with an upload after the other, none of which finds credit, it
    // would never go, and nor would what gives the credit back.
    if (next != nullptr && next != sent.payload && next == outbox_.UnsentMessage(0).payload) {
      PayloadUpload upload;
      upload.sent.payload = std::move(next);
      BeginUploadLocked(std::move(upload), now_ns);
      return false;
    }
  }
  const uint64_t credit = stream_->credit_granted - stream_->credit_used;
  SensorMessage message;
  *message.mutable_batch() = stream_->encoder.Encode(outbox_, lane, policy_, credit, sent);
  const int count = message.batch().observations_size();
  if (count == 0) {
    if (stream_->encoder.full()) {
      ReopenLocked("this stream has no numbers left for new names");
    } else {
      stream_->exhausted_at = stream_->credit_granted;
    }
    return false;
  }
  if (lane == Lane::kMessages) {
    stream_->credit_used += message.batch().ByteSizeLong();
    stream_->upload.reset();
  }
  outbox_.MarkSent(lane, static_cast<size_t>(count));
  stream_->last_batch_ns[Index(lane)] = now_ns;
  batches_.Increment();
  observations_sent_.Increment(count);
  // A copy, for it is lost if the queue is full, and with it the names it introduces.
  if (!SendLocked(message)) stream_->stalled = std::move(message);
  return true;
}

bool Uplink::HasCreditLocked(Lane lane) const {
  return lane == Lane::kControl || stream_->exhausted_at != stream_->credit_granted;
}

int64_t Uplink::NextWakeLocked(int64_t now_ns) const {
  int64_t wake_ns = last_heartbeat_ns_ + absl::ToInt64Nanoseconds(options_.heartbeat);
  if (phase_ != Phase::kStreaming) return wake_ns;
  if (stream_->stalled.has_value()) return std::min(wake_ns, now_ns + kStallRetryNs);
  const bool uploading = stream_->upload.has_value();
  if (!uploading) {
    wake_ns = std::min(wake_ns, BacklogDueLocked(now_ns).value_or(wake_ns));
  } else if (!stream_->upload->written) {
    wake_ns = std::min(wake_ns, std::max(now_ns, stream_->upload->until_ns));
  }
  for (const Lane lane : kLanes) {
    // The next Credit wakes us, or what is written.
    if (!HasCreditLocked(lane) || (uploading && lane == Lane::kMessages)) continue;
    const std::optional<int64_t> due =
        outbox_.DueAt(lane, policy_, stream_->last_batch_ns[Index(lane)], now_ns);
    if (due.has_value()) wake_ns = std::min(wake_ns, *due);
  }
  return wake_ns;
}

}  // namespace rips::sensor
