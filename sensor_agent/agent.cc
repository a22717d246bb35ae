#include "sensor_agent/agent.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "sensor_agent/interest/interest_file.h"
#include "sensor_agent/uplink/store_file.h"
#include "services/base/status_macros.h"
#include "services/model/finding_digest.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/ros_name.h"
#include "services/runtime/log.h"

namespace rips::sensor {

namespace {

// Samples processed at a time: discovery is looked at in between.
constexpr size_t kSamplesAtOnce = 4'096;
// On a busy bus the observer looks this often instead of at every sample; the first after a pause
// is seen at once.
constexpr int64_t kBusyIntervalNs = 2 * kNanosPerMilli;
// Longest sleep; signals and replies wake it anyway.
constexpr int64_t kIdleNs = kNanosPerSecond;
// Since the start: as long as discovery and every grace may take.
constexpr int64_t kFindingsConfirmNs = 60 * kNanosPerSecond;
// How long a renewed discovery may take to tell everything that is there.
constexpr int64_t kResyncNs = 2 * kNanosPerSecond;

// What was received when the sensor is stopped is taken in so many steps at most; a busy bus would
// never let it stop.
constexpr int kLastPolls = 20;

// Payloads that may be held between reception and the outbox, which has a limit of its own.
constexpr size_t kPayloadsUnderwayBytes = size_t{16} << 20;

void AddFinding(Finding finding, int64_t now_ns, Observations& seen) {
  ControlObservation& observation = seen.findings.emplace_back();
  observation.boottime_ns = now_ns;
  observation.what = std::move(finding);
}

WriterKind KindOf(const EndpointFact& writer) {
  if (writer.topic == ros2::kDiscoveryTopic) return WriterKind::kDiscovery;
  if (ros2::DemangleTopic(writer.topic).kind != ros2::DdsTopicKind::kTopic) {
    return WriterKind::kUnread;
  }
  const bool latched = writer.qos.reliable && writer.qos.transient_local;
  return latched ? WriterKind::kLatched : WriterKind::kMessages;
}

Loss LimitLoss(uint64_t count, int64_t now_ns) {
  return {.cause = LossCause::kLimit,
          .count = count,
          .first_boottime_ns = now_ns,
          .last_boottime_ns = now_ns};
}

dds::DomainOptions DomainOptionsOf(const SensorConfig& config) {
  return {.id = config.dds.domain, .interface = config.dds.interface, .unicast_data = true};
}

// A step adds a node that is not RIPS's.
bool ShowsRobot(const std::vector<GraphChange>& steps) {
  return std::any_of(steps.begin(), steps.end(), [](const GraphChange& step) {
    return std::any_of(step.delta.upsert_nodes.begin(), step.delta.upsert_nodes.end(),
                       [](const ros2::Node& node) { return node.full_name != kOwnNode; });
  });
}

// What was in use when the last process ended. Null, for metadata of everything, if there is none.
std::shared_ptr<const Interest> KeptInterest(const std::string& state_dir) {
  auto interest = LoadInterest(InterestFile(state_dir));
  if (interest.ok()) return *std::move(interest);
  if (!absl::IsNotFound(interest.status())) {
    LogWarning("cannot use the interest of the last run; reading metadata of every topic",
               {{"file", InterestFile(state_dir)}, {"error", interest.status().ToString()}});
  }
  return nullptr;
}

IdsFeedOptions IdsOptions(const SensorConfig& config) {
  return {.logs = config.ids,
          .offsets_file = absl::StrCat(config.state_dir, "/ids-offsets"),
          .outbox_survives_stop = config.watch.outbox_disk.bytes > 0};
}

IdsSink SinkInto(Uplink* uplink) {
  return {.ready = [uplink] { return uplink->Ready().ok(); },
          .take =
              [uplink](std::vector<ControlObservation> alerts, std::vector<Loss> losses) {
                uplink->Append({.losses = std::move(losses), .ids_alerts = std::move(alerts)});
              },
          .acknowledged = [uplink] { return uplink->acknowledged_ids_alerts(); },
          .blind =
              [uplink](std::vector<std::string> reasons) {
                uplink->SetBlind("ids", std::move(reasons));
              }};
}

}  // namespace

Agent::Agent(const SensorConfig& config, const Clock* clock, Metrics* metrics)
    : config_(config),
      clock_(clock),
      samples_(metrics->AddCounter("rips_sensor_samples_total", "Samples received")),
      duplicates_(metrics->AddCounter("rips_sensor_duplicates_total",
                                      "Samples that another reader delivered, too")),
      unattributed_(metrics->AddCounter("rips_sensor_unattributed_total",
                                        "Messages whose writer has no node")),
      payloads_shed_(metrics->AddCounter(
          "rips_sensor_payloads_shed_total",
          "Payloads that were asked for and not kept; their messages were, as metadata")),
      foreign_claims_(metrics->AddCounter("rips_sensor_foreign_claims_total",
                                          "Claims on nodes or endpoints of other participants")),
      bad_claims_(metrics->AddCounter("rips_sensor_undecodable_claims_total",
                                      "Messages of ros_discovery_info that make no sense")),
      lost_(metrics->AddCounter("rips_sensor_lost_total",
                                "Observations not taken, whatever the cause")),
      readers_(metrics->AddGauge("rips_sensor_readers", "Topics being read")),
      graph_left_out_(metrics->AddGauge(
          "rips_sensor_graph_left_out",
          "Participants, nodes and endpoints left out of the graph since it was whole")),
      announced_(metrics->AddGauge(
          "rips_sensor_announced",
          "1 while this sensor announces itself to ROS tools as the node /rips")) {}

absl::StatusOr<std::unique_ptr<Agent>> Agent::Create(const SensorConfig& config,
                                                     rpc::CredentialsSource credentials,
                                                     const Clock* clock, Metrics* metrics,
                                                     rpc::CertificateMonitor* monitor,
                                                     OnSettings on_settings) {
  std::unique_ptr<Agent> agent(new Agent(config, clock, metrics));
  Agent* raw = agent.get();
  const auto memory = static_cast<size_t>(config.watch.outbox_memory.bytes);
  std::function<void(const rpc::Peer&)> on_peer;
  if (monitor != nullptr) on_peer = [monitor](const rpc::Peer& peer) { monitor->Seen(peer); };
  agent->uplink_ = std::make_unique<Uplink>(
      UplinkOptions{.servers = config.servers,
                    .credentials = std::move(credentials),
                    .on_peer = std::move(on_peer),
                    .host = config.host,
                    .domain = config.dds.domain,
                    .settings = config.settings,
                    .refused = config.refused,
                    .interest_file = InterestFile(config.state_dir),
                    .store_file = StoreFile(config.state_dir),
                    .core = {.outbox = {.message_bytes = memory / 2, .control_bytes = memory},
                             .backlog = {.memory_bytes = memory / 2}},
                    .spool = {.dir = config.spool_dir,
                              .disk_bytes = static_cast<uint64_t>(config.watch.outbox_disk.bytes),
                              .boot_id = BootId(),
                              .now = clock->Now()}},
      Uplink::Hooks{
          .on_own_participants =
              [raw](std::vector<ros2::Guid> participants) {
                {
                  MutexLock lock(&raw->inbox_mu_);
                  raw->own_participants_ = std::move(participants);
                }
                raw->Wake();
              },
          .on_protected_parts =
              [raw](std::vector<std::string> parts) {
                {
                  MutexLock lock(&raw->inbox_mu_);
                  raw->protected_parts_ = std::move(parts);
                }
                raw->Wake();
              },
          .on_snapshot_wanted = [raw] { raw->Wake(); },
          .on_server_forgot =
              [raw] {
                {
                  MutexLock lock(&raw->inbox_mu_);
                  raw->server_forgot_ = true;
                }
                raw->Wake();
              },
          .on_interest =
              [raw](std::shared_ptr<const Interest> interest) {
                {
                  MutexLock lock(&raw->inbox_mu_);
                  raw->interest_ = std::move(interest);
                }
                raw->Wake();
              },
          .on_primary =
              [raw](bool primary) {
                {
                  MutexLock lock(&raw->inbox_mu_);
                  raw->primary_ = primary;
                }
                raw->Wake();
              },
          .on_settings = std::move(on_settings)},
      clock, metrics);
  RIPS_RETURN_IF_ERROR(agent->uplink_->Open());
  RIPS_ASSIGN_OR_RETURN(std::optional<dds::Enclave> enclave,
                        dds::LoadSecurity(config.dds, absl::FromUnixNanos(clock->Now().unix_ns)));
  const bool secured = enclave.has_value();
  const bool admits_strangers = secured && enclave->admits_unauthenticated;
  if (admits_strangers) {
    LogWarning(
        "governance admits unauthenticated participants; not reporting any participant as "
        "unauthenticated");
  }
  auto domain = DomainWatch::Create(
      {.domain = DomainOptionsOf(config),
       .participant = {.security = std::move(enclave)},
       .topics = {.payload_bytes = static_cast<size_t>(config.watch.outbox_memory.bytes) +
                                   kPayloadsUnderwayBytes,
                  .secured = secured}},
      [raw] { raw->Wake(); });
  if (domain.ok()) {
    agent->domain_ = *std::move(domain);
  } else if (dds::MayComeWithAnInterface(domain.status())) {
    agent->no_domain_ = domain.status();
  } else {
    return domain.status();
  }
  const bool joined = agent->domain_ != nullptr;
  const ros2::Guid own = joined ? agent->domain_->own() : ros2::Guid();
  if (config.wire && joined) {
    RIPS_ASSIGN_OR_RETURN(
        agent->wire_,
        wire::WireInput::Create(
            {.socket = config.wire_socket, .domain = config.dds.domain, .secured = secured},
            [raw] { raw->Wake(); }, metrics));
  }
  const int64_t grace_ns = absl::ToInt64Nanoseconds(config.watch.attribution_grace);
  const int64_t settle_ns = absl::ToInt64Nanoseconds(config.watch.settle);
  GraphOptions options{.own = own,
                       .secured = secured && !admits_strangers,
                       .observer_hidden = config.watch.observer_hidden,
                       .unwatched = config.watch.unwatched,
                       .attribution_grace_ns = grace_ns,
                       .settle_ns = settle_ns,
                       .limits = config.watch.graph_limits};
  agent->started_ns_ = clock->Now().boottime_ns;
  agent->graph_.emplace(std::move(options), agent->started_ns_);
  agent->flow_.emplace(FlowOptions{.attribution_grace_ns = grace_ns}, &*agent->graph_);
  agent->findings_.emplace(FindingsOptions{.own = own,
                                           .secured = secured && !admits_strangers,
                                           .raw_readers = config.watch.raw_readers});
  agent->sequences_.emplace(
      SequenceWatchOptions{},
      [raw](const ros2::Guid& writer) { return raw->domain_->NumbersOf(writer); },
      [raw](const ros2::Guid& writer) { raw->domain_->ForgetNumbersOf(writer); });
  agent->watch_.unwatched = config.watch.unwatched;
  agent->watch_.interest = KeptInterest(config.state_dir);
  if (agent->watch_.interest != nullptr) {
    agent->uplink_->InterestInUse(agent->watch_.interest->id());
  }
  agent->FollowPlan(clock->Now().boottime_ns);
  if (joined) {
    agent->uplink_->SetParticipant(own);
    if (config.dds.announce) agent->StartAnnouncing();
  }
  if (!config.ids.empty()) {
    agent->ids_ = std::make_unique<IdsFeed>(IdsOptions(config), SinkInto(agent->uplink_.get()),
                                            clock, metrics);
  }
  return agent;
}

Agent::~Agent() { Stop(); }

void Agent::StartAnnouncing() {
  auto announcer = dds::NodeAnnouncer::Create(
      domain_->participant(), dds::AnnouncerOptions(config_.dds), clock_->Now().boottime_ns);
  if (announcer.ok()) {
    announcer_ = *std::move(announcer);
    announced_.Set(1);
    return;
  }
  LogWarning(
      "this sensor cannot announce itself to ROS, whose tools show its readers without a node; "
      "under DDS Security its permissions must let it publish ros_discovery_info",
      {{"error", announcer.status().ToString()}});
}

void Agent::Announce(int64_t now_ns) {
  if (announcer_ == nullptr) return;
  const absl::Status told = announcer_->Poll(now_ns);
  if (told.ok() == announcing_) return;
  announcing_ = told.ok();
  announced_.Set(announcing_ ? 1 : 0);
  if (announcing_) return;
  LogWarning("this sensor's node was not announced; trying again", {{"error", told.ToString()}});
}

void Agent::Start(std::function<void()> on_turn) {
  uplink_->Start();
  observer_ = std::thread([this, on_turn = std::move(on_turn)] { Observe(on_turn); });
  if (ids_ != nullptr) ids_->Start();
}

void Agent::Stop() {
  {
    MutexLock lock(&inbox_mu_);
    stopping_ = true;
    inbox_cond_.NotifyOne();
  }
  if (observer_.joinable()) observer_.join();
  if (ids_ != nullptr) ids_->Stop();
  if (uplink_ != nullptr) uplink_->Stop();
}

void Agent::OnSignal(const std::string& name) {
  {
    MutexLock lock(&inbox_mu_);
    // More at once than this say no more than this many.
    if (signals_.size() < kSamplesAtOnce) signals_.push_back(name);
  }
  Wake();
}

void Agent::Wake() {
  if (woken_.exchange(true)) return;
  MutexLock lock(&inbox_mu_);
  inbox_cond_.NotifyOne();
}

bool Agent::WaitForWork(int64_t deadline_ns) {
  MutexLock lock(&inbox_mu_);
  while (!stopping_ && !woken_ && clock_->Now().boottime_ns < deadline_ns) {
    inbox_cond_.WaitUntil(lock, deadline_ns);
  }
  return !stopping_;
}

void Agent::Observe(const std::function<void()>& on_turn) {
  int64_t last_poll_ns = 0;
  while (WaitForWork(std::min(NextWork(), clock_->Now().boottime_ns + kIdleNs))) {
    // The next sample has come close behind the last: let some more come.
    const int64_t rest_ns = last_poll_ns + kBusyIntervalNs - clock_->Now().boottime_ns;
    if (rest_ns > 0) absl::SleepFor(absl::Nanoseconds(rest_ns));
    last_poll_ns = clock_->Now().boottime_ns;
    Poll(last_poll_ns);
    if (uplink_->snapshot_wanted()) ResendGraph(last_poll_ns);
    if (on_turn) on_turn();
  }
  // What has been received so far is not lost with the process, either.
  for (int i = 0; i < kLastPolls; ++i) {
    Poll(clock_->Now().boottime_ns);
    if (!woken_) break;
  }
}

void Agent::Poll(int64_t now_ns) {
  woken_ = false;
  Observations seen;
  ApplyInbox(now_ns, seen);
  if (domain_ != nullptr) PollDomain(now_ns, seen);
  uplink_->Append(std::move(seen));
}

void Agent::PollDomain(int64_t now_ns, Observations& seen) {
  PollDiscovery(now_ns, seen);
  PollSequences(now_ns);
  PollCoverage(now_ns);
  // Now that readers have been opened and closed.
  Announce(now_ns);
  PollClaims(now_ns, seen);
  seen.graph = graph_->Poll(now_ns);
  seen.settled = graph_->settled();
  PollSamples(now_ns, seen);
  PollFindings(now_ns, seen);
  PollWire(now_ns, seen);
  SumFindings(now_ns, seen);
  CountLimits(now_ns, seen);
  if (!sees_robot_) sees_robot_ = seen.settled && ShowsRobot(seen.graph);
}

void Agent::SayDdsProblem(const std::string& why) {
  uplink_->SetBlind("dds", why.empty() ? std::vector<std::string>() : std::vector{why});
}

int64_t Agent::NextWork() const {
  if (domain_ == nullptr) return kNever;
  const int64_t work_ns =
      std::min({graph_->NextDue(), flow_->NextDue(), findings_->NextDue(), sequences_->NextDue(),
                domain_->topics().NextDue(), announcer_ ? announcer_->NextDue() : kNever});
  return resync_until_ns_ == 0 ? work_ns : std::min(work_ns, resync_until_ns_);
}

void Agent::ApplyInbox(int64_t now_ns, Observations& seen) {
  std::optional<std::vector<ros2::Guid>> own;
  std::optional<std::vector<std::string>> parts;
  std::shared_ptr<const Interest> interest;
  std::optional<bool> primary;
  bool forgot = false;
  {
    MutexLock lock(&inbox_mu_);
    seen.signals.swap(signals_);
    own.swap(own_participants_);
    parts.swap(protected_parts_);
    interest.swap(interest_);
    primary.swap(primary_);
    forgot = std::exchange(server_forgot_, false);
  }
  if (forgot) RepeatFindings(now_ns, seen);
  if (own.has_value() && own_.Told(*own)) ApplyOwnParticipants(now_ns);
  if (parts.has_value()) findings_->SetProtectedParts(*parts);
  const bool idle = primary.has_value() ? !*primary : watch_.idle;
  if (interest == nullptr && idle == watch_.idle) return;
  watch_.idle = idle;
  if (interest != nullptr) watch_.interest = interest;
  FollowPlan(now_ns);
  if (interest == nullptr) return;
  uplink_->InterestInUse(interest->id());
  if (!graph_limits_.is_short()) return;
  // What other rules name may have been left out.
  graph_limits_.Asked(now_ns);
  Rediscover(now_ns);
}

void Agent::ApplyOwnParticipants(int64_t now_ns) {
  graph_->SetOwnParticipants(own_.known(), now_ns);
  findings_->SetOwnParticipants(own_.known());
}

void Agent::FollowPlan(int64_t now_ns) {
  const auto plan = std::make_shared<const WatchPlan>(watch_);
  graph_->SetPlan(plan, now_ns);
  if (watch_.interest != nullptr) graph_->SetKeptTopics(watch_.interest->kept_topics());
  if (domain_ != nullptr) domain_->topics().SetPlan(plan, now_ns);
  ReportReaders(now_ns);
}

void Agent::ReportReaders(int64_t now_ns) {
  if (wire_ == nullptr) return;
  wire_->OnReaders([this](const ros2::Guid& writer) { return domain_->topics().Reads(writer); },
                   now_ns);
}

void Agent::PollCoverage(int64_t now_ns) {
  const std::vector<Coverage> all = domain_->topics().TakeCoverage(now_ns);
  for (const Coverage& news : all) {
    std::string why = ros2::Printable(news.not_visible);
    const auto left_out = why.empty() ? std::nullopt : bus_logs_.Admit("unreadable writers");
    if (left_out.has_value()) {
      const std::optional<ros2::Endpoint> writer = graph_->Find(news.writer);
      LogWarning("cannot read a writer", {{"topic", writer.has_value() ? writer->name : ""},
                                          {"writer", ToString(news.writer)},
                                          {"error", why},
                                          {"left_out", *left_out}});
    }
    if (why.empty() && wire_ != nullptr) why = wire_->NotVisible(news.writer);
    graph_->SetNotVisible(news.writer, why, now_ns);
  }
  if (!all.empty()) ReportReaders(now_ns);
}

void Agent::PollDiscovery(int64_t now_ns, Observations& seen) {
  for (const Discovered& each : domain_->TakeDiscovered()) {
    if (wire_ != nullptr) wire_->OnDiscovered(each, now_ns);
    if (const auto* endpoint = std::get_if<EndpointFact>(&each.what)) {
      OnEndpoint(*endpoint, each.alive, now_ns);
      continue;
    }
    OnParticipant(std::get<ros2::Participant>(each.what), each.alive, now_ns);
  }
  if (resync_until_ns_ != 0 && now_ns >= resync_until_ns_) {
    resync_until_ns_ = 0;
    graph_->EndResync(now_ns);
  }
  const uint64_t lost = domain_->TakeLostDiscovered();
  if (lost == 0) return;
  LogError("discovery queue overflowed; restarting discovery", {{"lost_facts", lost}});
  seen.losses.push_back(LimitLoss(lost, now_ns));
  lost_.Increment(static_cast<double>(lost));
  graph_->FactsLost(lost);
  facts_lost_ += lost;
  Rediscover(now_ns);
}

void Agent::Rediscover(int64_t now_ns) {
  if (domain_ == nullptr) return;
  graph_->BeginResync();
  if (wire_ != nullptr) wire_->OnRediscovery(now_ns);
  resync_until_ns_ = now_ns + kResyncNs;
  if (absl::Status status = domain_->Rediscover(); !status.ok()) {
    LogError("cannot restart discovery", {{"error", status.ToString()}});
  }
}

void Agent::WatchGraphLimits(uint64_t left_out, int64_t now_ns) {
  const bool was_short = graph_limits_.is_short();
  const bool has_room = was_short && graph_->HasRoom();
  if (graph_limits_.Look(left_out, has_room, now_ns)) Rediscover(now_ns);
  if (was_short || left_out > 0) {
    graph_left_out_.Set(static_cast<double>(graph_->left_out()));
  }
  if (!was_short || graph_limits_.is_short()) return;
  graph_->EndTruncation();
  graph_left_out_.Set(0);
}

void Agent::OnParticipant(const ros2::Participant& participant, bool alive, int64_t now_ns) {
  if (alive) {
    sequences_->ParticipantSeen(participant.guid);
    return graph_->ParticipantSeen(participant, now_ns);
  }
  sequences_->ParticipantGone(participant.guid);
  findings_->OnParticipantGone(participant.guid);
  graph_->ParticipantGone(participant.guid, now_ns);
  if (announcer_ != nullptr) announcer_->Gone(participant.guid);
}

void Agent::OnEndpoint(const EndpointFact& endpoint, bool alive, int64_t now_ns) {
  if (!alive) {
    flow_->WriterGone(endpoint.guid, now_ns);
    sequences_->WriterGone(endpoint.guid);
    graph_->EndpointGone(endpoint.guid, now_ns);
    findings_->OnEndpointGone(endpoint.guid);
    domain_->topics().EndpointGone(endpoint.guid);
    return;
  }
  if (endpoint.guid.SamePrefix(domain_->own())) return;
  graph_->EndpointSeen(endpoint, now_ns);
  findings_->OnEndpointSeen(endpoint, now_ns);
  if (endpoint.writer) sequences_->WriterSeen(endpoint.guid, KindOf(endpoint));
  if (ros2::DemangleTopic(endpoint.topic).kind != ros2::DdsTopicKind::kTopic) return;
  // What goes wrong is reported by PollCoverage.
  domain_->topics().Watch(endpoint, now_ns).IgnoreError();
  if (wire_ != nullptr && domain_->topics().Reads(endpoint.guid)) {
    wire_->OnRead(endpoint.guid, now_ns);
  }
}

void Agent::OnSequenceJump(const SequenceJump& jump) {
  sequences_->Jumped(jump);
  if (sequences_->NextDue() == 0) woken_ = true;  // in the next turn
}

void Agent::PollSequences(int64_t now_ns) {
  for (const SequenceJump& jump : sequences_->Poll(now_ns)) {
    domain_->topics().SetJumped(jump.writer);
    const std::optional<ros2::Endpoint> writer = graph_->Find(jump.writer);
    findings_->OnSequenceJump({.guid = jump.writer,
                               .node = writer.has_value() ? writer->node : "",
                               .topic = writer.has_value() ? writer->name : "",
                               .detail = jump.detail});
  }
}

void Agent::PollClaims(int64_t now_ns, Observations& seen) {
  for (const Claim& claim : domain_->TakeClaims()) {
    size_t misnamed = 0;
    const auto entities = ros2::DecodeParticipantEntities(claim.payload, {}, &misnamed);
    if (!entities.ok() || misnamed > 0) {
      bad_claims_.Increment();
      if (const auto left_out = bus_logs_.Admit("undecodable claims")) {
        const std::string error =
            entities.ok() ? absl::StrCat(misnamed, " nodes have names that no node can have")
                          : entities.status().ToString();
        LogWarning("cannot decode ros_discovery_info",
                   {{"writer", ToString(claim.writer)}, {"error", error}, {"left_out", *left_out}});
      }
      seen.losses.push_back({.cause = LossCause::kUndecodable,
                             .count = 1,
                             .first_boottime_ns = now_ns,
                             .last_boottime_ns = now_ns});
    }
    if (!entities.ok()) continue;
    if (announcer_ != nullptr) announcer_->Heard(claim.writer.Participant(), claim.payload);
    const absl::Status taken = graph_->NodesClaimed(claim.writer, *entities, now_ns);
    findings_->OnClaim(claim.writer, taken, now_ns);
    if (taken.ok()) continue;
    if (const auto left_out = bus_logs_.Admit("refused claims")) {
      LogWarning("ros_discovery_info rejected",
                 {{"error", taken.ToString()}, {"left_out", *left_out}});
    }
  }
  const uint64_t lost = domain_->TakeLostClaims();
  if (lost == 0) return;
  LogError("sensor too slow for ros_discovery_info; samples lost", {{"lost", lost}});
  lost_.Increment(static_cast<double>(lost));
  seen.losses.push_back(LimitLoss(lost, now_ns));
}

void Agent::PollSamples(int64_t now_ns, Observations& seen) {
  MessageFlow::Output output;
  flow_->Poll(now_ns, output);
  std::vector<Sample> samples = domain_->topics().Take(kSamplesAtOnce);
  samples_.Increment(static_cast<double>(samples.size()));
  payloads_shed_.Increment(static_cast<double>(domain_->topics().TakePayloadsRefused()));
  // After the samples were taken, and before they are looked at.
  for (const QueueLoss& loss : domain_->topics().TakeLosses()) {
    flow_->QueueLost(loss.writer, loss.topic, loss.count, now_ns, output);
    if (wire_ != nullptr) wire_->OnSamplesLost();
  }
  for (Sample& sample : samples) {
    if (wire_ != nullptr) wire_->OnSample(sample.writer, sample.sequence);
    flow_->Take(std::move(sample), now_ns, output);
  }
  if (samples.size() == kSamplesAtOnce) woken_ = true;  // there is more
  seen.messages = std::move(output.messages);
  for (const SequenceJump& jump : output.jumps) OnSequenceJump(jump);
  for (Loss& loss : output.losses) {
    lost_.Increment(static_cast<double>(loss.count));
    seen.losses.push_back(std::move(loss));
  }
}

void Agent::PollFindings(int64_t now_ns, Observations& seen) {
  for (const GraphChange& change : seen.graph) findings_->OnGraph(change, now_ns);
  findings_->SetConnected(uplink_->Ready().ok(), now_ns);
  for (Finding& finding : findings_->Poll(now_ns)) {
    Log(finding.over ? LogLevel::kInfo : LogLevel::kWarning,
        finding.over ? "finding over" : "finding",
        {{"kind", finding.kind},
         {"guid", ToString(finding.guid)},
         {"node", finding.node},
         {"topic", finding.topic},
         {"detail", finding.detail}});
    AddFinding(std::move(finding), now_ns, seen);
  }
  if (const bool hidden = findings_->secured_strangers() > 0; hidden != secured_hidden_) {
    secured_hidden_ = hidden;
    uplink_->SetKindVisible(kSecuredParticipants, !hidden);
  }
  const uint64_t dropped = findings_->dropped() - findings_dropped_;
  findings_dropped_ += dropped;
  if (dropped > 0) seen.losses.push_back(LimitLoss(dropped, now_ns));
  lost_.Increment(static_cast<double>(dropped));
}

void Agent::ResendGraph(int64_t now_ns) {
  std::vector<GraphChange> snapshot = graph_->Snapshot(now_ns);
  for (const GraphChange& change : snapshot) findings_->OnGraph(change, now_ns);
  uplink_->ReplaceGraph(std::move(snapshot));
}

void Agent::RepeatFindings(int64_t now_ns, Observations& seen) {
  for (Finding& finding : findings_->Told()) AddFinding(std::move(finding), now_ns, seen);
  if (wire_ == nullptr) return;
  for (ControlObservation& finding : wire_->Standing(now_ns)) {
    seen.findings.push_back(std::move(finding));
  }
}

void Agent::SumFindings(int64_t now_ns, Observations& seen) {
  FindingsTold told = findings_told_.value_or(FindingsTold());
  if (!seen.findings.empty()) {
    told.digest = 0;
    for (const Finding& finding : findings_->Told()) told.digest += model::DigestOf(finding);
    if (wire_ != nullptr) {
      for (const ControlObservation& finding : wire_->Standing(now_ns)) {
        told.digest += model::DigestOf(std::get<Finding>(finding.what));
      }
    }
  }
  told.all = now_ns >= started_ns_ + kFindingsConfirmNs && graph_->settled() &&
             findings_->told_all() && (wire_ == nullptr || wire_->ToldAll(now_ns));
  if (told == findings_told_) return;
  findings_told_ = told;
  seen.findings_told = told;
}

void Agent::PollWire(int64_t now_ns, Observations& seen) {
  if (wire_ == nullptr) return;
  for (ControlObservation& finding : wire_->Poll(*graph_, now_ns)) {
    seen.findings.push_back(std::move(finding));
  }
  for (const wire::Jump& jump : wire_->TakeJumps()) {
    OnSequenceJump({.writer = jump.writer, .detail = jump.detail});
  }
  for (const Coverage& news : wire_->TakeCoverage()) {
    // What TopicWatcher knows against it stands.
    if (news.not_visible.empty() && !domain_->topics().Reads(news.writer)) continue;
    graph_->SetNotVisible(news.writer, news.not_visible, now_ns);
  }
  for (MessageSeen& message : wire_->TakeUnseen(*graph_, now_ns)) {
    seen.messages.push_back(std::move(message));
  }
  if (wire_->WantsRediscovery()) Rediscover(now_ns);
  if (const bool visible = wire_->visible(now_ns); visible != wire_visible_) {
    wire_visible_ = visible;
    for (const char* kind : kSeenByTap) uplink_->SetKindVisible(kind, visible);
  }
  std::vector<std::string> blind = wire_->Blind(now_ns);
  if (blind == wire_blind_) return;
  wire_blind_ = blind;
  uplink_->SetBlind("wire", std::move(blind));
}

void Agent::CountLimits(int64_t now_ns, Observations& seen) {
  const GraphCounters graph = graph_->counters();
  const FlowCounters flow = flow_->counters();
  const auto count = [](const Counter& counter, uint64_t now, uint64_t before) {
    if (now > before) counter.Increment(static_cast<double>(now - before));
  };
  count(duplicates_, flow.duplicates, flow_counted_.duplicates);
  count(unattributed_, flow.unattributed, flow_counted_.unattributed);
  count(foreign_claims_, graph.foreign_claims, graph_counted_.foreign_claims);
  count(lost_, graph.dropped, graph_counted_.dropped);
  if (graph.dropped > graph_counted_.dropped) {
    seen.losses.push_back(LimitLoss(graph.dropped - graph_counted_.dropped, now_ns));
  }
  WatchGraphLimits(graph.dropped - graph_counted_.dropped + std::exchange(facts_lost_, 0), now_ns);
  graph_counted_ = graph;
  flow_counted_ = flow;
  readers_.Set(static_cast<double>(domain_->topics().readers()));
}

}  // namespace rips::sensor
