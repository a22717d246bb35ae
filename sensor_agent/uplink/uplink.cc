#include "sensor_agent/uplink/uplink.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "rips/v1/sensor.grpc.pb.h"
#include "sensor_agent/interest/interest_file.h"
#include "services/base/check.h"
#include "services/base/ids.h"
#include "services/model_proto/configuration_codec.h"
#include "services/ros2/ros_name.h"
#include "services/rpc/status_conversion.h"
#include "services/runtime/daemon_flags.h"
#include "services/runtime/log.h"
#include "services/wire_limits/field_limits.h"

namespace rips::sensor {

namespace {

using rips::v1::SensorMessage;
using rips::v1::SensorReply;

constexpr uint32_t kProtocol = 1;
// Batches handed to the client and not yet written. Few: what waits there is in front of control
// observations that come later, and the outbox holds everything anyway.
constexpr size_t kClientQueue = 32;
// Chunks that are with the client. Everything else goes before those that are not yet being written
// (SendBulk), so there may be many: each turn between the two threads costs time on a busy machine.
constexpr size_t kUnwrittenMax = 32;
// Parts watched over; four actuators name no more.
constexpr size_t kProtectedPartsMax = 1'024;
// What the server may set; other values are clamped.
constexpr uint32_t kBatchObservationsMax = 256;
constexpr uint32_t kBatchBytesMin = 1024;
constexpr uint32_t kBatchBytesMax = 1 << 20;
constexpr uint32_t kLingerMsMax = 1000;
constexpr int64_t kNever = std::numeric_limits<int64_t>::max();

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

std::vector<ros2::Guid> OwnParticipants(const rips::v1::SensorConfig& config) {
  std::vector<ros2::Guid> own;
  for (const std::string& bytes : config.own_participants()) {
    const absl::StatusOr<ros2::Guid> guid = ros2::GuidFromBytes(bytes);
    if (guid.ok()) {
      own.push_back(*guid);
    } else {
      LogWarning("server sent a malformed participant", {{"error", guid.status().message()}});
    }
  }
  return own;
}

void SetClock(Instant now, rips::v1::Clock* clock) {
  clock->set_boottime_ns(static_cast<uint64_t>(now.boottime_ns));
  clock->set_unix_ns(now.unix_ns);
}

void Announce(const AnnouncedRange& announced, rips::v1::SensorHello& hello) {
  const BacklogRange& range = announced.range;
  rips::v1::SpoolStream* spooled = hello.add_spooled();
  if (announced.acknowledged.has_value()) {
    spooled->set_acknowledged_sequence(*announced.acknowledged);
  }
  spooled->set_incarnation(range.stream.incarnation);
  spooled->set_first_sequence(range.first_sequence);
  spooled->set_last_sequence(range.last_sequence);
  spooled->set_lane(range.stream.lane == Lane::kControl ? rips::v1::CONTROL : rips::v1::MESSAGES);
}

}  // namespace

Uplink::Uplink(UplinkOptions options, Hooks hooks, const Clock* clock, Metrics* metrics)
    : options_(std::move(options)),
      hooks_(std::move(hooks)),
      clock_(clock),
      store_(options_.store_file),
      metrics_(metrics),
      core_(options_.core, NewIncarnation(), NewIncarnation()),
      down_because_(absl::UnavailableError("not connected yet")),
      configuration_(model_proto::Encode(options_.settings, options_.refused)) {}

Uplink::~Uplink() { Stop(); }

std::unique_ptr<UplinkClient> Uplink::MakeClient() {
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
  return std::make_unique<UplinkClient>(
      std::move(options),
      UplinkClient::Callbacks{
          .start_stream =
              [](const std::shared_ptr<grpc::Channel>& channel, grpc::ClientContext* context) {
                return std::unique_ptr<UplinkClient::Stream>(
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

absl::Status Uplink::Open() {
  if (options_.spool.dir.empty() || options_.spool.disk_bytes == 0) return absl::OkStatus();
  absl::StatusOr<std::unique_ptr<Spool>> spool = Spool::Open(options_.spool);
  if (absl::IsFailedPrecondition(spool.status())) return spool.status();
  Backlog::Disk disk{.bytes_max = spool.ok() ? options_.spool.disk_bytes : 0,
                     .refuses = !spool.ok()};
  if (spool.ok()) {
    spool_ = std::make_unique<SpoolThread>(
        *std::move(spool), [this](SpoolResult result) { OnSpoolResult(std::move(result)); });
  } else {
    LogError("no spool on disk; unacknowledged observations are kept in memory only",
             {{"error", spool.status().message()}});
  }
  MutexLock lock(&mu_);
  core_.SetDisk(disk);
  return absl::OkStatus();
}

void Uplink::Start() {
  RIPS_CHECK(client_ == nullptr, "an uplink starts once");
  store_.Load();
  client_ = MakeClient();
  sender_ = std::thread([this] { Run(); });
}

void Uplink::Stop() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    WakeLocked(0);
  }
  if (sender_.joinable()) sender_.join();
  if (client_ == nullptr || std::exchange(stopped_, true)) return;
  client_->Stop();
  store_.Save();
  uint64_t left = 0;
  {
    MutexLock lock(&mu_);
    if (spool_ != nullptr) {
      HandleLocked(Stopping{});
      while (!core_.drained()) changed_.Wait(lock);
    }
    left = core_.backlog().Unwritten();
  }
  if (spool_ != nullptr) spool_->Stop(/*clean=*/left == 0);
  if (left > 0) {
    LogError(
        "no disk space for the spool; unacknowledged observations are lost when the sensor stops",
        {{"observations", left}});
  }
}

// --- From the sensor

void Uplink::Append(Observations observations) { Handle(std::move(observations)); }

bool Uplink::snapshot_wanted() const {
  MutexLock lock(&mu_);
  return core_.outbox().snapshot_wanted();
}

void Uplink::ReplaceGraph(std::vector<GraphChange> snapshot) {
  Handle(WholeGraph{.snapshot = std::move(snapshot)});
}

void Uplink::SetKindVisible(const std::string& kind, bool visible) {
  Handle(KindVisible{.kind = kind, .visible = visible});
}

void Uplink::SetBlind(const std::string& input, std::vector<std::string> reasons) {
  for (std::string& reason : reasons) reason = ros2::Printable(reason);
  Handle(Blindness{.input = input, .reasons = std::move(reasons)});
}

void Uplink::SetParticipant(const ros2::Guid& participant) {
  MutexLock lock(&mu_);
  participant_ = participant;
}

void Uplink::SayConfiguration(const std::vector<ConfigSetting>& settings,
                              const std::vector<std::string>& refused) {
  MutexLock lock(&mu_);
  configuration_ = model_proto::Encode(settings, refused);
  if (!writer_.has_value()) return;
  HandleLocked(StreamEnded{});
  ReopenLocked("the configuration has changed");
}

void Uplink::InterestInUse(const std::string& id) {
  MutexLock lock(&mu_);
  interest_.InUse(id);
  WakeLocked(0);
}

absl::Status Uplink::Ready() const {
  MutexLock lock(&mu_);
  if (core_.phase() == UplinkCore::Phase::kStreaming) return absl::OkStatus();
  const std::string held =
      absl::StrCat("; ", core_.outbox().bytes() + core_.backlog().state().memory_bytes,
                   " bytes wait in memory, ", core_.backlog().disk().bytes, " on disk");
  if (core_.phase() == UplinkCore::Phase::kResuming) {
    return absl::UnavailableError("connected, resuming" + held);
  }
  return absl::Status(down_because_.code(), absl::StrCat(down_because_.message(), held));
}

uint64_t Uplink::acknowledged_ids_alerts() const {
  MutexLock lock(&mu_);
  return core_.outbox().acknowledged_ids_alerts();
}

std::string Uplink::incarnation() const {
  MutexLock lock(&mu_);
  return core_.incarnation();
}

// --- The client's callbacks

SensorMessage Uplink::OnConnected() {
  MutexLock lock(&mu_);
  Outcome outcome = HandleLocked(StreamBegan{.incarnation = NewIncarnation()});
  RIPS_CHECK(outcome.hello.has_value(), "a stream begins with a hello");
  return *std::move(outcome.hello);
}

SensorMessage Uplink::MakeHello(const SendHello& action, Instant now) {
  if (action.incarnation_is_new) {
    LogWarning("server rejected this incarnation; starting a new one");
  }
  writer_.emplace(action.incarnation, options_.encoder);
  interest_.StreamBegan();
  SensorMessage message;
  rips::v1::SensorHello* sensor = message.mutable_hello();
  rips::v1::Hello* hello = sensor->mutable_hello();
  hello->set_protocol(kProtocol);
  hello->set_version(std::string(RipsVersion()));
  hello->set_incarnation(action.incarnation);
  hello->set_host(options_.host);
  SetClock(now, hello->mutable_clock());
  *hello->mutable_configuration() = configuration_;
  sensor->set_domain(options_.domain);
  if (!participant_.none()) sensor->set_participant_guid(participant_.ToBytes());
  sensor->set_interest_in_use(interest_.in_use());
  const rips::v1::StorePoint store = store_.Get();
  if (!store.generation().empty()) *sensor->mutable_store() = store;
  for (const std::string& kind : action.not_visible) sensor->add_not_visible(kind);
  for (const std::string& reason : action.blind) sensor->add_blind(reason);
  for (const AnnouncedRange& each : action.ranges) Announce(each, *sensor);
  wire_limits::CutToLimits(message);
  return message;
}

void Uplink::OnMessage(const SensorReply& reply) {
  switch (reply.kind_case()) {
    case SensorReply::kInterest:
      return OnInterest(reply.interest());
    case SensorReply::kConfig:
      return OnConfig(reply.config());
    case SensorReply::kAck: {
      const rips::v1::Ack& ack = reply.ack();
      if (ack.lane() != rips::v1::CONTROL && ack.lane() != rips::v1::MESSAGES) return;
      store_.Raise(ack.commit());
      const Lane lane = ack.lane() == rips::v1::CONTROL ? Lane::kControl : Lane::kMessages;
      return Handle(AckReceived{.stream = {.incarnation = ack.incarnation(), .lane = lane},
                                .sequence = ack.durable_sequence()});
    }
    case SensorReply::kCredit:
      return Handle(CreditReceived{.message_bytes = reply.credit().message_bytes(),
                                   .payload_bytes = reply.credit().payload_bytes()});
    case SensorReply::kHeartbeat:
      return Handle(ServerHeartbeat{.boottime_ns = reply.heartbeat().clock().boottime_ns()});
    case SensorReply::kRedirect: {
      MutexLock lock(&mu_);
      if (!writer_.has_value()) return;
      redirect_ = reply.redirect().target();
      HandleLocked(StreamEnded{});
      return ReopenLocked("redirected");
    }
    case SensorReply::KIND_NOT_SET:
      return;  // of a later version
  }
}

void Uplink::OnConfig(const rips::v1::SensorConfig& config) {
  if (config.has_store()) store_.Set(config.store());
  Outcome outcome;
  {
    MutexLock lock(&mu_);
    if (!writer_.has_value()) return;
    outcome = HandleLocked(ConfigReceived{
        .policy = {.observations =
                       std::clamp(config.batch_observations(), 1u, kBatchObservationsMax),
                   .bytes = std::clamp(config.batch_bytes(), kBatchBytesMin, kBatchBytesMax),
                   .linger_ns = std::min(config.linger_ms(), kLingerMsMax) * kNanosPerMilli},
        .heartbeat_ms = config.heartbeat_ms(),
        .primary = config.primary(),
        .want_snapshot = config.want_snapshot(),
        .want_findings = config.want_findings()});
  }
  hooks_.on_own_participants(OwnParticipants(config));
  if (hooks_.on_protected_parts) hooks_.on_protected_parts(ProtectedParts(config));
  store_.Save();
  if (hooks_.on_primary) hooks_.on_primary(config.primary());
  if (hooks_.on_settings && config.has_settings()) {
    hooks_.on_settings(model_proto::Decode(model_proto::Bounded(config.settings())));
  }
  CallHooks(outcome);
}

void Uplink::OnInterest(const rips::v1::Interest& wire) {
  {
    MutexLock lock(&mu_);
    const bool is_new = interest_.Offered(wire.id());
    WakeLocked(0);
    if (!is_new) return;
  }
  // Patterns take a while to compile: not under the lock.
  absl::StatusOr<std::shared_ptr<const Interest>> interest = InterestFromWire(wire);
  {
    MutexLock lock(&mu_);
    if (!interest.ok()) {
      const std::string problem = interest.status().ToString();
      LogWarning("interest rejected; keeping the previous one", {{"error", problem}});
      interest_.Rejected(wire.id(), problem);
      return WakeLocked(0);
    }
    interest_.HandedOn(wire.id());
  }
  if (!options_.interest_file.empty()) {
    if (absl::Status kept = SaveInterest(options_.interest_file, wire); !kept.ok()) {
      LogWarning("cannot save the interest for the next start", {{"error", kept.ToString()}});
    }
  }
  hooks_.on_interest(*std::move(interest));
}

void Uplink::OnDisconnected(const grpc::Status& status, rpc::CloseClass close_class) {
  const absl::Status why = rpc::FromGrpc(status);
  store_.Save();
  MutexLock lock(&mu_);
  metrics_.stream_ends.Increment();
  HandleLocked(StreamEnded{.status = why});
  StreamGoneLocked(why.ok() ? absl::UnavailableError("the server ended the stream") : why);
  // The same again and again is logged once.
  const bool news = logged_ != why.code();
  logged_ = why.code();
  Log(news ? LogLevel::kWarning : LogLevel::kDebug, "no stream to the policy server",
      {{"class", rpc::CloseClassName(close_class)}, {"error", down_because_.ToString()}});
}

void Uplink::OnWritten() {
  if (!waits_for_line_.exchange(false)) return;
  MutexLock lock(&mu_);
  // Chunks of another payload may be there by now.
  if (!LineHoldsLocked(1)) HandleLocked(LineFree{});
}

void Uplink::StreamGoneLocked(const absl::Status& why) {
  down_because_ = why;
  writer_.reset();
  interest_.StreamEnded();
  metrics_.streaming.Set(0);
}

void Uplink::ReopenLocked(const std::string& why) {
  LogWarning("reopening the stream", {{"reason", why}});
  StreamGoneLocked(absl::UnavailableError(why));
  reopen_ = true;
  WakeLocked(0);
}

// --- What the core wants done

// One function for each action; those with a result give it.
struct Uplink::Performer {
  using Result = std::optional<UplinkInput>;

  Result operator()(const SendHello& action) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    outcome.hello = uplink.MakeHello(action, now);
    return std::nullopt;
  }
  Result operator()(const SendHeartbeat& action) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    SensorMessage message;
    SetClock(now, message.mutable_heartbeat()->mutable_clock());
    message.mutable_heartbeat()->set_echo_boottime_ns(action.echo_boottime_ns);
    if (!uplink.client_->Send(std::move(message))) {
      LogDebug("heartbeat dropped: the server does not read the stream");
    }
    return std::nullopt;
  }
  Result operator()(const SendBatch& action) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    const BatchSent sent = uplink.writer_->Send(action, uplink.core_.outbox(), *uplink.client_);
    if (sent.status == SendStatus::kSent) CountBatch(sent.count);
    return sent;
  }
  Result operator()(const SendChunk& action) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    if (uplink.LineHoldsLocked(kUnwrittenMax)) return ChunkSent{.sent = false};
    const ChunkSent sent = uplink.writer_->Send(action, *uplink.client_);
    if (sent.sent) uplink.metrics_.payload_bytes.Increment(static_cast<double>(action.bytes));
    return sent;
  }
  Result operator()(const TakeChunksBack&) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    ChunksTakenBack taken;
    for (const SensorMessage& each : uplink.client_->RecallBulk()) {
      taken.bytes += each.chunk().data().size();
    }
    LogDebug("payload dropped: the uplink is too slow", {{"bytes_not_sent", taken.bytes}});
    return taken;
  }
  Result operator()(const AwaitLine&) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    if (uplink.LineHoldsLocked(1)) return std::nullopt;
    return LineFree{};
  }
  Result operator()(const OpenBacklog& action) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    return uplink.writer_->Open(action, now.boottime_ns);
  }
  Result operator()(const SendBacklog& action) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    const BacklogSent sent = uplink.writer_->Send(action, *uplink.client_);
    if (sent.status == SendStatus::kSent) CountBatch(sent.count);
    return sent;
  }
  Result operator()(const EncodeForBacklog& action) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    return EncodeAlone(action);
  }
  Result operator()(const StreamResumed&) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    uplink.logged_.reset();
    uplink.metrics_.streaming.Set(1);
    LogInfo("streaming", {{"unacked_bytes", uplink.core_.outbox().bytes()}});
    return std::nullopt;
  }
  Result operator()(const CloseStream& action) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    uplink.ReopenLocked(action.why);
    return std::nullopt;
  }
  Result operator()(const WantGraph&) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    outcome.want_graph = true;
    return std::nullopt;
  }
  Result operator()(const ServerForgot&) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    outcome.server_forgot = true;
    return std::nullopt;
  }
  Result operator()(const BacklogLost& action) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    LogError("backlog observations lost",
             {{"first_sequence", action.first_sequence}, {"error", action.why.message()}});
    return std::nullopt;
  }
  Result operator()(const SpoolWrite& job) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    return Push(job);
  }
  Result operator()(const SpoolRead& job) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    return Push(job);
  }
  Result operator()(const SpoolRelease& job) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    return Push(job);
  }

  Result Push(SpoolJob job) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    uplink.spool_->Push(std::move(job));
    return std::nullopt;
  }
  void CountBatch(size_t observations) ABSL_EXCLUSIVE_LOCKS_REQUIRED(uplink.mu_) {
    uplink.metrics_.batches.Increment();
    uplink.metrics_.observations_sent.Increment(static_cast<double>(observations));
  }

  Uplink& uplink;
  const Instant now;
  Outcome& outcome;
};

void Uplink::Handle(UplinkInput input) {
  Outcome outcome;
  {
    MutexLock lock(&mu_);
    outcome = HandleLocked(std::move(input));
  }
  CallHooks(outcome);
}

Uplink::Outcome Uplink::HandleLocked(UplinkInput input) {
  Outcome outcome;
  Performer performer{*this, clock_->Now(), outcome};
  UplinkActions actions = core_.On(std::move(input), performer.now);
  std::vector<UplinkInput> results;
  for (size_t done = 0;; ++done) {
    for (UplinkAction& each : actions.list) {
      if (auto result = std::visit(performer, each)) results.push_back(*std::move(result));
    }
    if (done == results.size()) break;
    actions = core_.On(std::move(results[done]), performer.now);
  }
  WakeLocked(actions.wake_ns);
  return outcome;
}

void Uplink::CallHooks(const Outcome& outcome) {
  if (outcome.server_forgot && hooks_.on_server_forgot) hooks_.on_server_forgot();
  if (outcome.want_graph) hooks_.on_snapshot_wanted();
}

bool Uplink::LineHoldsLocked(size_t chunks) {
  if (client_->bulk_unwritten() < chunks) return false;
  waits_for_line_ = true;
  // What was written in between has not called OnWritten.
  return client_->bulk_unwritten() >= chunks;
}

void Uplink::WakeLocked(int64_t at_ns) {
  if (at_ns >= next_wake_ns_) return;
  next_wake_ns_ = at_ns;
  changed_.NotifyAll();
}

void Uplink::SendAnswersLocked() {
  while (const rips::v1::InterestApplied* answer = interest_.Front()) {
    SensorMessage message;
    *message.mutable_interest_applied() = *answer;
    if (!client_->Send(std::move(message))) return;  // at the next wake-up
    interest_.PopFront();
  }
}

// --- The sender thread, and the disk

void Uplink::Run() {
  // The hello announces what former processes left.
  if (spool_ != nullptr) Recover();
  client_->Start();
  while (true) {
    Outcome outcome;
    bool reopen = false;
    {
      MutexLock lock(&mu_);
      while (!stopping_ && clock_->Now().boottime_ns < next_wake_ns_) {
        changed_.WaitUntil(lock, next_wake_ns_);
      }
      if (stopping_) return;
      reopen = std::exchange(reopen_, false);
      if (!reopen) {
        next_wake_ns_ = kNever;
        SendAnswersLocked();
        outcome = HandleLocked(Turn{});
        metrics_.Update(core_, clock_->Now().boottime_ns);
      }
    }
    CallHooks(outcome);
    if (!reopen) continue;
    client_->Stop();
    client_ = MakeClient();
    client_->Start();
  }
}

void Uplink::Recover() {
  Recovered recovered = spool_->Recover();
  for (const std::string& problem : recovered.problems) {
    LogWarning("spool", {{"problem", problem}});
  }
  const uint64_t bytes = spool_->recovered_bytes();
  if (!recovered.records.empty()) {
    LogInfo("found observations of a previous run",
            {{"batches", recovered.records.size()}, {"bytes", bytes}});
  }
  MutexLock lock(&mu_);
  HandleLocked(std::move(recovered));
  HandleLocked(SpoolReleased{.disk_bytes = bytes});
}

void Uplink::OnSpoolResult(SpoolResult result) {
  MutexLock lock(&mu_);
  const auto* written = std::get_if<SpoolWritten>(&result);
  const absl::Status status = written == nullptr ? absl::OkStatus() : written->record.status();
  const bool refused = core_.backlog().state().disk_refuses;
  std::visit([&](auto& each) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { HandleLocked(std::move(each)); },
             result);
  if (!status.ok() && !refused) {
    LogError("spool full; keeping new observations in memory and dropping them when that is full",
             {{"error", status.message()}});
  } else if (written != nullptr && status.ok() && refused) {
    LogInfo("spool accepts observations again");
  }
  changed_.NotifyAll();  // Stop waits for it
}

}  // namespace rips::sensor
