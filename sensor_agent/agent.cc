#include "sensor_agent/agent.h"

#include <algorithm>
#include <utility>

#include "absl/time/clock.h"
#include "services/base/status_macros.h"
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
// How long a renewed discovery may take to tell everything that is there.
constexpr int64_t kResyncNs = 2 * kNanosPerSecond;

// Payloads that may be held between reception and the outbox, which has a limit of its own.
constexpr size_t kPayloadsUnderwayBytes = size_t{16} << 20;

void AddFinding(Finding finding, int64_t now_ns, Observations& seen) {
  ControlObservation& observation = seen.findings.emplace_back();
  observation.boottime_ns = now_ns;
  observation.what = std::move(finding);
}

Loss LimitLoss(uint64_t count, int64_t now_ns) {
  return {.cause = LossCause::kLimit,
          .count = count,
          .first_boottime_ns = now_ns,
          .last_boottime_ns = now_ns};
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
      readers_(metrics->AddGauge("rips_sensor_readers", "Topics being read")) {}

absl::StatusOr<std::unique_ptr<Agent>> Agent::Create(
    const SensorConfig& config, std::shared_ptr<grpc::ChannelCredentials> credentials,
    const Clock* clock, Metrics* metrics) {
  std::unique_ptr<Agent> agent(new Agent(config, clock, metrics));
  Agent* raw = agent.get();
  agent->uplink_ = std::make_unique<Uplink>(
      UplinkOptions{.servers = config.servers,
                    .credentials = std::move(credentials),
                    .host = config.host,
                    .domain = config.dds.domain,
                    .outbox = {.message_bytes = static_cast<size_t>(config.outbox_memory.bytes),
                               .control_bytes = static_cast<size_t>(config.outbox_memory.bytes)}},
      Uplink::Hooks{.on_own_participants =
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
                    .on_interest =
                        [raw](std::shared_ptr<const Interest> interest) {
                          {
                            MutexLock lock(&raw->inbox_mu_);
                            raw->interest_ = std::move(interest);
                          }
                          raw->Wake();
                        }},
      clock, metrics);
  RIPS_ASSIGN_OR_RETURN(std::optional<dds::Enclave> enclave,
                        dds::LoadSecurity(config.dds, absl::FromUnixNanos(clock->Now().unix_ns)));
  const bool secured = enclave.has_value();
  const bool admits_strangers = secured && enclave->admits_unauthenticated;
  if (admits_strangers) {
    LogWarning(
        "the governance admits participants that have not authenticated; who has is not "
        "known, and nobody is a finding for it");
  }
  RIPS_ASSIGN_OR_RETURN(
      agent->domain_,
      DomainWatch::Create(
          {.domain = {.id = config.dds.domain, .interface = config.dds.interface},
           .participant = {.security = std::move(enclave)},
           .topics = {.payload_bytes = static_cast<size_t>(config.outbox_memory.bytes) +
                                       kPayloadsUnderwayBytes}},
          [raw] { raw->Wake(); }));
  const int64_t grace_ns = absl::ToInt64Nanoseconds(config.attribution_grace);
  const int64_t settle_ns = absl::ToInt64Nanoseconds(config.settle);
  GraphOptions options{.own = agent->domain_->own(),
                       .secured = secured && !admits_strangers,
                       .observer_hidden = config.observer_hidden,
                       .unwatched = config.unwatched,
                       .attribution_grace_ns = grace_ns,
                       .settle_ns = settle_ns};
  agent->graph_.emplace(std::move(options), clock->Now().boottime_ns);
  agent->flow_.emplace(FlowOptions{.attribution_grace_ns = grace_ns}, &*agent->graph_);
  agent->findings_.emplace(
      FindingsOptions{.own = agent->domain_->own(), .secured = secured && !admits_strangers});
  return agent;
}

Agent::~Agent() { Stop(); }

void Agent::Start() {
  uplink_->Start();
  observer_ = std::thread([this] { Observe(); });
}

void Agent::Stop() {
  {
    MutexLock lock(&inbox_mu_);
    stopping_ = true;
    inbox_cond_.NotifyOne();
  }
  if (observer_.joinable()) observer_.join();
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

void Agent::Observe() {
  int64_t last_look_ns = 0;
  while (WaitForWork(std::min(NextWork(), clock_->Now().boottime_ns + kIdleNs))) {
    // The next sample has come close behind the last: let some more come.
    const int64_t rest_ns = last_look_ns + kBusyIntervalNs - clock_->Now().boottime_ns;
    if (rest_ns > 0) absl::SleepFor(absl::Nanoseconds(rest_ns));
    woken_ = false;
    const int64_t now_ns = clock_->Now().boottime_ns;
    last_look_ns = now_ns;
    Observations seen;
    TakeInbox(now_ns, seen);
    TakeDiscovered(now_ns, seen);
    TakeClaims(now_ns, seen);
    seen.graph = graph_->Poll(now_ns);
    seen.settled = graph_->settled();
    TakeSamples(now_ns, seen);
    TakeFindings(now_ns, seen);
    CountLimits(now_ns, seen);
    uplink_->Append(std::move(seen));
    if (uplink_->snapshot_wanted()) TellAnew(now_ns);
  }
}

int64_t Agent::NextWork() const {
  const int64_t work_ns = std::min({graph_->NextDue(), flow_->NextDue(), findings_->NextDue()});
  return resync_until_ns_ == 0 ? work_ns : std::min(work_ns, resync_until_ns_);
}

void Agent::TakeInbox(int64_t now_ns, Observations& seen) {
  std::optional<std::vector<ros2::Guid>> own;
  std::optional<std::vector<std::string>> parts;
  std::shared_ptr<const Interest> interest;
  {
    MutexLock lock(&inbox_mu_);
    seen.signals.swap(signals_);
    own.swap(own_participants_);
    parts.swap(protected_parts_);
    interest.swap(interest_);
  }
  if (interest != nullptr) {
    domain_->topics().SetInterest(interest);
    uplink_->InterestInUse(interest->id());
  }
  if (own.has_value()) {
    graph_->SetOwnParticipants(*own, now_ns);
    findings_->SetOwnParticipants(*own);
  }
  if (parts.has_value()) findings_->SetProtectedParts(*parts);
}

void Agent::TakeDiscovered(int64_t now_ns, Observations& seen) {
  for (const Discovered& each : domain_->TakeDiscovered()) {
    if (const auto* endpoint = std::get_if<EndpointFact>(&each.what)) {
      OnEndpoint(*endpoint, each.alive, now_ns);
      continue;
    }
    const auto& participant = std::get<ros2::Participant>(each.what);
    if (each.alive) {
      graph_->ParticipantSeen(participant, now_ns);
    } else {
      graph_->ParticipantGone(participant.guid, now_ns);
    }
  }
  if (resync_until_ns_ != 0 && now_ns >= resync_until_ns_) {
    resync_until_ns_ = 0;
    graph_->EndResync(now_ns);
  }
  const uint64_t lost = domain_->TakeLostDiscovered();
  if (lost == 0) return;
  LogError("discovery outran the sensor; asking for all of it again", {{"lost_facts", lost}});
  seen.losses.push_back(LimitLoss(lost, now_ns));
  lost_.Increment(static_cast<double>(lost));
  graph_->BeginResync();
  resync_until_ns_ = now_ns + kResyncNs;
  if (absl::Status status = domain_->Rediscover(); !status.ok()) {
    LogError("discovery cannot be asked again", {{"error", status.ToString()}});
  }
}

void Agent::OnEndpoint(const EndpointFact& endpoint, bool alive, int64_t now_ns) {
  if (!alive) {
    graph_->EndpointGone(endpoint.guid, now_ns);
    findings_->OnEndpointGone(endpoint.guid);
    flow_->WriterGone(endpoint.guid, now_ns);
    domain_->topics().WriterGone(endpoint.guid);
    return;
  }
  if (endpoint.guid.SamePrefix(domain_->own())) return;
  graph_->EndpointSeen(endpoint, now_ns);
  findings_->OnEndpointSeen(endpoint, now_ns);
  if (!endpoint.writer) return;
  const ros2::DemangledTopic topic = ros2::DemangleTopic(endpoint.topic);
  if (topic.kind != ros2::DdsTopicKind::kTopic || !graph_->Watched(topic.name)) return;
  const absl::Status watched = domain_->topics().Watch(endpoint);
  if (watched.ok()) return;
  LogWarning("a writer cannot be read", {{"topic", topic.name}, {"error", watched.ToString()}});
  graph_->SetNotVisible(endpoint.guid, ros2::Printable(watched.message()), now_ns);
}

void Agent::TakeClaims(int64_t now_ns, Observations& seen) {
  for (const Claim& claim : domain_->TakeClaims()) {
    const auto entities = ros2::DecodeParticipantEntities(claim.payload);
    if (!entities.ok()) {
      bad_claims_.Increment();
      LogWarning("claim about nodes makes no sense",
                 {{"writer", ToString(claim.writer)}, {"error", entities.status().ToString()}});
      seen.losses.push_back({.cause = LossCause::kUndecodable,
                             .count = 1,
                             .first_boottime_ns = now_ns,
                             .last_boottime_ns = now_ns});
      continue;
    }
    const absl::Status taken = graph_->NodesClaimed(claim.writer, *entities, now_ns);
    findings_->OnClaim(claim.writer, taken, now_ns);
    if (!taken.ok()) LogWarning("claim about nodes refused", {{"error", taken.ToString()}});
  }
  const uint64_t lost = domain_->TakeLostClaims();
  if (lost == 0) return;
  LogError("claims about nodes outran the sensor", {{"lost", lost}});
  lost_.Increment(static_cast<double>(lost));
  seen.losses.push_back(LimitLoss(lost, now_ns));
}

void Agent::TakeSamples(int64_t now_ns, Observations& seen) {
  MessageFlow::Output output;
  flow_->Poll(now_ns, output);
  std::vector<Sample> samples = domain_->topics().Take(kSamplesAtOnce);
  samples_.Increment(static_cast<double>(samples.size()));
  payloads_shed_.Increment(static_cast<double>(domain_->topics().TakePayloadsRefused()));
  for (Sample& sample : samples) flow_->Take(std::move(sample), now_ns, output);
  if (samples.size() == kSamplesAtOnce) woken_ = true;  // there is more
  seen.messages = std::move(output.messages);
  for (Loss& loss : output.losses) seen.losses.push_back(std::move(loss));
  for (Loss& loss : domain_->topics().TakeLosses(now_ns)) {
    lost_.Increment(static_cast<double>(loss.count));
    seen.losses.push_back(std::move(loss));
  }
}

void Agent::TakeFindings(int64_t now_ns, Observations& seen) {
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

void Agent::TellAnew(int64_t now_ns) {
  std::vector<GraphChange> snapshot = graph_->Snapshot(now_ns);
  for (const GraphChange& change : snapshot) findings_->OnGraph(change, now_ns);
  uplink_->ReplaceGraph(std::move(snapshot));
  Observations again;
  for (Finding& finding : findings_->Told()) {
    AddFinding(std::move(finding), now_ns, again);
  }
  if (!again.findings.empty()) uplink_->Append(std::move(again));
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
  graph_counted_ = graph;
  flow_counted_ = flow;
  readers_.Set(static_cast<double>(domain_->topics().readers()));
}

}  // namespace rips::sensor
