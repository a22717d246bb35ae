#include "sensor_agent/outbox/uplink_core.h"

#include <algorithm>
#include <limits>
#include <utility>

namespace rips::sensor {

namespace {

// Streams whose acknowledgements are remembered; a hello announces fewer.
constexpr size_t kAcknowledgedMax = 256;
// After this many refused streams in a row the incarnation is given up.
constexpr int kRefusalsMax = 2;
// Batches set aside in one turn.
constexpr int kSetAsideAtOnce = 8;
// Batches of the backlog are as large whatever the server's config: it may be another one by the
// time they are sent.
constexpr BatchPolicy kAsidePolicy = {.observations = 128, .bytes = 32 * 1024};
constexpr Lane kLanes[] = {Lane::kControl, Lane::kMessages};

int Index(Lane lane) { return lane == Lane::kControl ? 0 : 1; }

void AddJobs(Backlog& backlog, int64_t now_ns, UplinkActions& actions) {
  while (std::optional<SpoolJob> job = backlog.NextJob(now_ns)) {
    std::visit([&](auto& each) { actions.list.emplace_back(std::move(each)); }, *job);
  }
}

}  // namespace

UplinkCore::UplinkCore(const UplinkCoreOptions& options, std::string incarnation,
                       std::string backlog_incarnation)
    : kept_{.outbox = Outbox(options.outbox),
            .backlog = Backlog(options.backlog, std::move(backlog_incarnation)),
            .live_ns = absl::ToInt64Nanoseconds(options.live),
            .backlog_bytes_per_second = options.backlog_bytes_per_second},
      incarnation_(std::move(incarnation)),
      look_{.length_ns = absl::ToInt64Nanoseconds(options.heartbeat)},
      heartbeat_(look_) {}

// --- Inputs

// One function for each input. What comes from the server counts only while there is a stream.
struct UplinkCore::Handler {
  void operator()(Observations& in) { core.Append(std::move(in), now_ns, actions); }
  void operator()(WholeGraph& in) {
    core.kept_.outbox.ReplaceGraph(std::move(in.snapshot), now_ns);
    core.hurry_ = true;
  }
  void operator()(KindVisible& in) { core.status_.SetKindVisible(in.kind, in.visible); }
  void operator()(Blindness& in) { core.status_.SetBlind(in.input, std::move(in.reasons)); }

  void operator()(StreamBegan& in) {
    core.BeginStream(std::move(in.incarnation), actions);
    core.heartbeat_.last_ns = now_ns;  // the hello says as much
    core.hurry_ = true;
  }
  void operator()(StreamEnded& in) { core.EndStream(in.status, now_ns, actions); }
  void operator()(ConfigReceived& in) {
    if (!core.session_.has_value()) return;
    core.kept_.policy = in.policy;
    core.heartbeat_.length_ns = model::HeartbeatIntervalNs(in.heartbeat_ms, core.look_.length_ns);
    core.kept_.outbox.SetPrimary(in.primary);
    core.resume_.config = true;
    core.resume_.wants_snapshot |= in.want_snapshot;
    if (in.want_findings) actions.list.emplace_back(ServerForgot{});
    core.FinishResume(now_ns, actions);
  }
  void operator()(CreditReceived& in) {
    if (!core.session_.has_value()) return;
    core.session_->messages.Grant(in.message_bytes);
    core.session_->payloads.Grant(in.payload_bytes);
    core.resume_.credit = true;
    core.FinishResume(now_ns, actions);
  }
  void operator()(AckReceived& in) {
    if (!core.session_.has_value()) return;
    core.OnAck(in, now_ns, actions);
    AddJobs(core.kept_.backlog, now_ns, actions);
  }
  void operator()(ServerHeartbeat& in) {
    core.server_boottime_ns_ = std::max(core.server_boottime_ns_, in.boottime_ns);
  }

  void operator()(Turn&) {
    core.hurry_ = false;
    core.set_aside_left_ = kSetAsideAtOnce;
    core.Heartbeat(now_ns, actions);
    core.Continue(now_ns, actions);
  }
  void operator()(LineFree&) {
    if (core.session_.has_value()) core.session_->OnLineFree();
    core.hurry_ = true;
  }
  void operator()(BatchSent& in) {
    Sent([&](SendSession& to) { to.On(in, now_ns); });
  }
  void operator()(ChunkSent& in) {
    Sent([&](SendSession& to) { to.On(in); });
  }
  void operator()(ChunksTakenBack& in) {
    Sent([&](SendSession& to) { to.On(in, now_ns); });
  }
  void operator()(BacklogOpened& in) {
    Sent([&](SendSession& to) { Report(to.On(in, now_ns)); });
  }
  void operator()(BacklogSent& in) {
    Sent([&](SendSession& to) { Report(to.On(in, now_ns)); });
  }
  void operator()(Encoded& in) {
    core.kept_.backlog.Put(in.stream, in.first_sequence, in.count, in.oldest_ns,
                           std::move(in.bytes));
    if (!core.stopping_) core.SetAsideNext(now_ns, actions);
    AddJobs(core.kept_.backlog, now_ns, actions);
  }

  void operator()(Recovered& in) { core.kept_.backlog.Recover(in, now_ns); }
  void operator()(SpoolReleased& in) { core.kept_.backlog.On(in); }
  void operator()(SpoolWritten& in) {
    core.kept_.backlog.On(std::move(in), now_ns);
    AddJobs(core.kept_.backlog, now_ns, actions);
    core.hurry_ = true;
  }
  void operator()(SpoolReadBack& in) {
    const absl::Status status = in.bytes.status();
    if (const auto lost = core.kept_.backlog.On(std::move(in), now_ns)) {
      Report(BacklogLost{.first_sequence = *lost, .why = status});
    }
    AddJobs(core.kept_.backlog, now_ns, actions);
    core.hurry_ = true;
  }
  void operator()(Stopping&) { core.Stop(now_ns, actions); }

  template <typename Apply>
  void Sent(const Apply& apply) {
    if (!core.session_.has_value()) return;
    apply(*core.session_);
    core.Continue(now_ns, actions);
  }
  void Report(std::optional<BacklogLost> lost) {
    if (lost.has_value()) actions.list.emplace_back(*std::move(lost));
  }

  UplinkCore& core;
  int64_t now_ns;
  UplinkActions& actions;
};

UplinkActions UplinkCore::On(UplinkInput input, Instant now) {
  UplinkActions actions;
  Handler handler{*this, now.boottime_ns, actions};
  std::visit(handler, input);
  actions.wake_ns = hurry_ ? now.boottime_ns : NextWake(now.boottime_ns);
  return actions;
}

void UplinkCore::Append(Observations observations, int64_t now_ns, UplinkActions& actions) {
  Outbox& outbox = kept_.outbox;
  for (GraphChange& change : observations.graph) outbox.AddGraph(std::move(change), now_ns);
  for (MessageSeen& message : observations.messages) outbox.AddMessage(std::move(message));
  for (Loss& loss : observations.losses) outbox.AddLoss(std::move(loss));
  for (const std::string& signal : observations.signals) outbox.AddSignal(signal, now_ns);
  for (ControlObservation& alert : observations.ids_alerts) outbox.AddControl(std::move(alert));
  for (ControlObservation& finding : observations.findings) outbox.AddControl(std::move(finding));
  if (observations.findings_told) status_.SetFindings(*observations.findings_told);
  if (observations.settled && !outbox.messages_released()) {
    outbox.ReleaseMessages();
    kept_.released_ns = now_ns;
  }
  if (outbox.snapshot_wanted()) actions.list.emplace_back(WantGraph{});
  hurry_ |= OutboxIsFull();
}

// --- A stream's life

void UplinkCore::BeginStream(std::string fresh_incarnation, UplinkActions& actions) {
  const bool renew = refusals_ >= kRefusalsMax;
  if (renew) {
    refusals_ = 0;
    incarnation_ = std::move(fresh_incarnation);
    kept_.outbox.Renumber();
  }
  kept_.outbox.Rewind();
  session_.emplace(&kept_);
  resume_ = {};
  heartbeat_.length_ns = look_.length_ns;
  phase_ = Phase::kResuming;
  status_.OnHello();
  actions.list.emplace_back(SendHello{.incarnation = incarnation_,
                                      .incarnation_is_new = renew,
                                      .ranges = Announce(),
                                      .not_visible = status_.not_visible(),
                                      .blind = status_.blind()});
}

std::vector<AnnouncedRange> UplinkCore::Announce() {
  std::vector<AnnouncedRange> ranges;
  std::map<StreamKey, uint64_t> announced;
  const auto add = [&](BacklogRange range) {
    AnnouncedRange& each = ranges.emplace_back(AnnouncedRange{.range = std::move(range)});
    const auto known = acknowledged_.find(each.range.stream);
    if (known == acknowledged_.end()) return;
    each.acknowledged = known->second;
    announced.insert(*known);
  };
  for (const Lane lane : kLanes) {
    const SequenceRange range = kept_.outbox.Unacked(lane);
    add({.stream = {.incarnation = incarnation_, .lane = lane},
         .first_sequence = range.first,
         .last_sequence = range.last});
  }
  for (BacklogRange& range : kept_.backlog.Rewind()) add(std::move(range));
  // No server asks for what is not announced any more.
  acknowledged_ = std::move(announced);
  return ranges;
}

void UplinkCore::EndStream(const absl::Status& why, int64_t now_ns, UplinkActions& actions) {
  if (phase_ == Phase::kStreaming) kept_.brought = {};
  phase_ = Phase::kDown;
  session_.reset();
  if (!absl::IsInvalidArgument(why)) return;
  ++refusals_;
  for (const auto& [stream, first_sequence] : kept_.backlog.OnRefused(now_ns)) {
    actions.list.emplace_back(BacklogLost{.first_sequence = first_sequence, .why = why});
  }
  AddJobs(kept_.backlog, now_ns, actions);
}

void UplinkCore::Close(std::string why, UplinkActions& actions) {
  if (phase_ == Phase::kStreaming) kept_.brought = {};
  phase_ = Phase::kDown;
  session_.reset();
  actions.list.emplace_back(CloseStream{.why = std::move(why)});
}

void UplinkCore::OnAck(const AckReceived& ack, int64_t now_ns, UplinkActions& actions) {
  hurry_ = true;
  // Only of streams that the last hello announced; a server may not fill our memory.
  if (acknowledged_.size() < kAcknowledgedMax || acknowledged_.contains(ack.stream)) {
    uint64_t& known = acknowledged_[ack.stream];
    known = std::max(known, ack.sequence);
  }
  absl::Status accepted;
  if (ack.stream.incarnation == incarnation_) {
    const Lane lane = ack.stream.lane;
    const uint64_t before = kept_.outbox.acknowledged(lane);
    const bool resuming = !std::exchange(resume_.ack[Index(lane)], true);
    if (resuming && lane == Lane::kControl && ack.sequence < before) {
      resume_.wants_snapshot = true;  // the server has lost what it knew of us
    }
    if (phase_ == Phase::kStreaming && ack.sequence > before) refusals_ = 0;
    accepted = kept_.outbox.Acknowledge(lane, ack.sequence);
  } else {
    accepted = kept_.backlog.Acknowledge(ack.stream, ack.sequence);
  }
  if (!accepted.ok()) return Close(std::string(accepted.message()), actions);
  FinishResume(now_ns, actions);
}

void UplinkCore::FinishResume(int64_t now_ns, UplinkActions& actions) {
  hurry_ = true;
  Outbox& outbox = kept_.outbox;
  if (phase_ == Phase::kResuming) {
    if (!resume_.complete()) return;
    phase_ = Phase::kStreaming;
    session_->Begin(now_ns);
    actions.list.emplace_back(StreamResumed{});
    if (refusals_ > 0) outbox.WantSnapshot();
  }
  const bool forgot =
      std::exchange(resume_.wants_snapshot, false) && !outbox.GraphStartsWithSnapshot();
  if (forgot) {
    if (!outbox.StartGraphWithSnapshot(now_ns)) outbox.WantSnapshot();
    actions.list.emplace_back(ServerForgot{});
  }
  if (outbox.snapshot_wanted()) actions.list.emplace_back(WantGraph{});
}

// --- Turns

void UplinkCore::Heartbeat(int64_t now_ns, UplinkActions& actions) {
  if (phase_ != Phase::kDown && heartbeat_.Pass(now_ns)) {
    actions.list.emplace_back(SendHeartbeat{.echo_boottime_ns = server_boottime_ns_});
  }
  if (!look_.Pass(now_ns)) return;
  MergeLosses();
  if (phase_ == Phase::kDown) return;
  if (kept_.backlog.state().announced_too_much) {
    return Close("the end of the backlog that was announced cannot be read", actions);
  }
  if (phase_ != Phase::kStreaming) return;
  if (const auto state = status_.Poll(kept_.outbox, kept_.backlog, now_ns)) {
    kept_.outbox.AddState(*state, now_ns);
  }
}

void UplinkCore::Continue(int64_t now_ns, UplinkActions& actions) {
  if (session_.has_value() && session_->names_used_up()) {
    Close("this stream has no numbers left for new names", actions);
  }
  if (phase_ == Phase::kStreaming) {
    while (std::optional<UplinkAction> action = session_->Next(now_ns)) {
      const bool has_result = !std::holds_alternative<AwaitLine>(*action);
      actions.list.push_back(*std::move(action));
      if (has_result) return;
    }
  }
  SetAsideNext(now_ns, actions);
  AddJobs(kept_.backlog, now_ns, actions);
}

bool UplinkCore::OutboxIsFull() const {
  const OutboxLimits& limits = kept_.outbox.limits();
  const bool full = kept_.outbox.message_bytes() > limits.message_bytes / 4 * 3 ||
                    kept_.outbox.control_bytes() > limits.control_bytes / 4 * 3;
  return full && kept_.backlog.HasRoom();
}

void UplinkCore::SetAsideNext(int64_t now_ns, UplinkActions& actions) {
  Outbox& outbox = kept_.outbox;
  const OutboxLimits& limits = outbox.limits();
  const auto many_messages = [&] { return outbox.message_bytes() > limits.message_bytes / 4 * 3; };
  hurry_ |= set_aside_left_ == 0;  // there may be more
  if (set_aside_left_ == 0 || !kept_.backlog.HasRoom()) return;
  const auto set_aside = [&](Lane lane, auto observations, std::vector<GraphChange> graph = {}) {
    --set_aside_left_;
    const StreamKey stream = kept_.backlog.Own(lane);
    actions.list.emplace_back(EncodeForBacklog{.stream = stream,
                                               .first_sequence = kept_.backlog.NextSequence(stream),
                                               .observations = std::move(observations),
                                               .graph = std::move(graph)});
  };
  if (outbox.control_bytes() > limits.control_bytes / 4 * 3) {
    std::vector<ControlObservation> control = outbox.PopOldestControl(kAsidePolicy);
    if (!control.empty()) return set_aside(Lane::kControl, std::move(control));
  }
  const bool streaming = phase_ == Phase::kStreaming;
  if (many_messages() && streaming) {
    // What the server has is judged, if not durably; what it does not have yet comes first.
    outbox.DropSentPayloads(limits.message_bytes / 8 * 5, kPayloadChunkBytes);
  }
  const std::optional<int64_t> oldest_ns = outbox.OldestUnnumbered();
  // Not the message whose payload is on its way: that is the oldest one.
  if (!oldest_ns.has_value() || (streaming && session_->uploading_live())) return;
  if (many_messages() && streaming) session_->ShedLatePayloads(now_ns, /*all=*/true);
  int64_t until_ns = 0;
  if (many_messages()) {
    until_ns = std::numeric_limits<int64_t>::max();
  } else if (outbox.messages_released() &&
             std::max(*oldest_ns, kept_.released_ns) < now_ns - kept_.live_ns) {
    // Some younger ones, too, so that batches do not hold one message each.
    until_ns = phase_ == Phase::kDown ? now_ns : now_ns - kept_.live_ns / 2;
  } else {
    return;
  }
  std::vector<MessageSeen> messages = outbox.PopOldest(kAsidePolicy, until_ns);
  if (messages.empty()) return;
  if (kept_.backlog.ShouldShedPayloads()) {
    for (MessageSeen& each : messages) outbox.ShedPayload(each);
  }
  std::vector<GraphChange> graph = outbox.GraphOf(messages, kept_.brought);
  set_aside(Lane::kMessages, std::move(messages), std::move(graph));
}

int64_t UplinkCore::NextWake(int64_t now_ns) const {
  int64_t wake_ns = look_.next_ns();
  if (phase_ != Phase::kDown) wake_ns = std::min(wake_ns, heartbeat_.next_ns());
  if (const auto retry_ns = kept_.backlog.RetryAt()) wake_ns = std::min(wake_ns, *retry_ns);
  return phase_ == Phase::kStreaming ? std::min(wake_ns, session_->NextDue(now_ns)) : wake_ns;
}

// --- The end

void UplinkCore::MergeLosses() {
  for (Loss& loss : kept_.backlog.PopLosses()) kept_.outbox.AddLoss(std::move(loss));
}

void UplinkCore::Stop(int64_t now_ns, UplinkActions& actions) {
  Outbox& outbox = kept_.outbox;
  phase_ = Phase::kDown;
  session_.reset();
  stopping_ = true;
  kept_.backlog.BeginStop();
  MergeLosses();
  outbox.CloseGraph(now_ns);
  outbox.FlushMerged(now_ns + outbox.limits().merge_ns);
  outbox.Rewind();
  const auto save = [&](Lane lane, const auto& drain) {
    while (outbox.unsent(lane) > 0) {
      EncodeForBacklog rest{.stream = {.incarnation = incarnation_, .lane = lane},
                            .first_sequence = outbox.NextSequence(lane)};
      drain(rest);
      actions.list.emplace_back(std::move(rest));
    }
  };
  save(Lane::kControl,
       [&](EncodeForBacklog& rest) { rest.observations = outbox.DrainControl(kAsidePolicy); });
  GraphTrail::Brought brought;
  save(Lane::kMessages, [&](EncodeForBacklog& rest) {
    std::vector<MessageSeen> messages = outbox.DrainMessages(kAsidePolicy);
    rest.graph = outbox.GraphOf(messages, brought);
    rest.observations = std::move(messages);
  });
  AddJobs(kept_.backlog, now_ns, actions);
}

}  // namespace rips::sensor
