#include "policy_server/server/robot/sensors/sensor_side.h"

#include <algorithm>
#include <map>
#include <set>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "services/model/dds_problem.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {
namespace {

// A sensor that gets other settings begins anew, a minute after it last did so.
constexpr int64_t kSettingsFollowedNs = 75 * kNanosPerSecond;

std::string Named(const SensorHost& host) { return absl::StrCat("sensor ", host.name); }

Lane LaneOf(const store::LaneKey& key) {
  return key.lane == store::LaneKey::Lane::kControl ? Lane::kControl : Lane::kMessages;
}

SensorSession NewSession(const input::SensorHello& in, Instant now) {
  const SensorHello& hello = in.hello;
  return {.id = in.session,
          .incarnation = hello.incarnation,
          .boottime_offset_ns = now.boottime_ns - hello.clock.boottime_ns,
          .unix_offset_ns = now.unix_ns - hello.clock.boottime_ns,
          .heard_ns = now.boottime_ns,
          .peer_boottime_ns = hello.clock.boottime_ns,
          .domain = hello.domain,
          .spooled = hello.spooled,
          .interest_in_use = hello.interest_in_use};
}

}  // namespace

SensorSide::SensorSide(Context* context, Alerts* alerts, EvidenceGate* evidence,
                       OwnAgents* own_agents, Losses* losses, const store::RobotRecord& record)
    : context_(*context),
      alerts_(*alerts),
      evidence_(*evidence),
      own_agents_(*own_agents),
      losses_(*losses) {
  SetHosts(context_.config);
  for (const auto& [key, sequence] : record.high_water) {
    const auto it = hosts_.find(key.host);
    if (it == hosts_.end()) continue;
    const std::string incarnation = absl::HexStringToBytes(key.incarnation);
    it->second.sequences.Load(incarnation, LaneOf(key), sequence);
    it->second.durable.Load(incarnation, LaneOf(key), sequence);
  }
}

bool SensorSide::OnHello(const input::SensorHello& in) {
  const auto it = hosts_.find(in.host);
  if (it == hosts_.end()) {
    context_.Do(action::Close{in.session, absl::PermissionDeniedError(absl::StrCat(
                                              "the inventory lists no sensor `", in.host,
                                              "` of robot `", context_.config.id, "`"))});
    return false;
  }
  SensorHost& host = it->second;
  const SensorHello& hello = in.hello;
  if (host.session) {
    if (context_.now_ns() - host.session->heard_ns < context_.timing.stale_ns) {
      own_agents_.OnRefused(Named(host), hello.peer);
      context_.Do(action::Close{
          in.session, absl::AlreadyExistsError(absl::StrCat("sensor ", context_.config.id, "/",
                                                            in.host, " has a live session"))});
      return false;
    }
    Close(host, absl::AbortedError("replaced by a newer session"));
  }
  own_agents_.OnSession(Named(host), hello.peer);
  host.session = NewSession(in, context_.now());
  if (host.graph_incarnation != hello.incarnation) {
    host.settled = false;
    // If the process before comes back, after one that was not it, it is asked for its graph, too.
    host.graph_incarnation.clear();
  }
  const uint64_t missing = losses_.LostBefore(host, in);
  OnRestart(host, hello);
  SendSetup(host);
  GrantCredit(host);
  // Not what is judged: its alerts may still wait for the disk.
  for (const SpooledRange& range : hello.spooled) {
    context_.Do(action::Acknowledge{.session = in.session,
                                    .incarnation = range.incarnation,
                                    .lane = range.lane,
                                    .sequence = host.durable.Judged(range.incarnation, range.lane),
                                    .commit = in.store.commit});
  }
  evidence_.Disturb(absl::StrCat("sensor ", in.host, " connected"), context_.now());
  if (missing > 0) losses_.OnMissing(host, missing);
  if (std::exchange(host.lost, false)) {
    alerts_.Raise(engine::Severity::kInfo, absl::StrCat("sensor ", in.host, " is back"));
  }
  context_.events.push_back(engine::AgentEvent{.agent = "sensor", .state = "connected"});
  return true;
}

// What the hello says of the process that sends it.
void SensorSide::OnRestart(SensorHost& host, const SensorHello& hello) {
  // It has an alert of its own.
  const bool moved = std::any_of(hello.blind.begin(), hello.blind.end(), [](const auto& reason) {
    return absl::StartsWith(reason, model::kDdsBeginsAgain);
  });
  if (moved) host.restarts.Expect(context_.now_ns() + 1);
  if (host.restarts.Began(hello.incarnation, context_.now_ns())) {
    alerts_.Raise(engine::Severity::kHigh,
                  absl::StrCat("sensor ", host.name, " has restarted ", RestartCount::kRestartsMax,
                               " times within ten minutes"));
    context_.events.push_back(engine::AgentEvent{.agent = "sensor", .state = "restarting"});
  }
  host.state = {.not_visible = hello.not_visible, .blind = hello.blind};
  host.state_boottime_ns = hello.clock.boottime_ns;
  if (hello.participant.none()) return;
  host.graph.SetObserver(hello.participant);
  own_agents_.AddParticipant(Named(host), hello.participant);
  for (auto& [name, other] : hosts_) {
    if (&other != &host && other.session) SendSetup(other);
  }
}

void SensorSide::SendSetups() {
  for (auto& [name, host] : hosts_) {
    if (host.session) SendSetup(host);
  }
}

void SensorSide::SendSetup(SensorHost& host, bool want_findings) {
  const bool primary = IsPrimary(host);
  context_.Do(action::Setup{
      .session = host.session->id,
      .setup = {
          .linger_ms = context_.timing.linger_ms,
          .heartbeat_ms = static_cast<uint32_t>(context_.timing.heartbeat_ns / kNanosPerMilli),
          .own_participants = own_agents_.participants(),
          .protected_parts = own_agents_.parts(),
          .primary = primary,
          .want_snapshot = primary && host.graph_incarnation != host.session->incarnation,
          .want_findings = want_findings,
          .settings = context_.config.sensor_settings,
          .store = context_.store}});
  if (primary) SendInterest(host);
}

void SensorSide::AskFindings(const std::string& host) {
  SensorHost* listed = Listed(host);
  if (listed != nullptr && listed->session) SendSetup(*listed, /*want_findings=*/true);
}

void SensorSide::SendInterest(SensorHost& host) {
  context_.Do(action::SetInterest{.host = host.name,
                                  .session = host.session->id,
                                  .plan = context_.watch.plan(context_.policy),
                                  .limits = context_.watch.limits(context_.policy),
                                  .kept_topics = context_.watch.kept_topics(context_.policy)});
}

void SensorSide::AskInterest() {
  for (auto& [name, host] : hosts_) {
    host.graph.SetKeptTopics(context_.watch.kept_topics(context_.policy));
  }
  SensorHost* host = primary();
  if (host != nullptr && host->session) SendInterest(*host);
}

void SensorSide::OnInterestSent(const input::InterestSent& in) {
  SensorHost* host = Find(in.host, in.session);
  if (host == nullptr) return;
  const std::string before = std::exchange(host->session->interest_wanted, in.id);
  if (before == in.id) return;
  host->session->interest_problem.clear();
  if (before.empty()) return;
  // Until the sensor has it in use, it may leave out what the new rules need.
  evidence_.Disturb("the sensors are asked to watch something else", context_.now());
}

void SensorSide::OnInterestAnswer(const input::InterestAnswer& in) {
  SensorHost* host = Hear(in.host, in.session);
  if (host == nullptr) return;
  SensorSession& session = *host->session;
  if (in.answer.problem.empty()) {
    session.interest_in_use = in.answer.id;
    if (in.answer.id == session.interest_wanted) session.interest_problem.clear();
    return;
  }
  if (in.answer.id != session.interest_wanted || in.answer.id == session.interest_in_use) return;
  // A repetition is no news.
  if (!session.interest_problem.empty()) return;
  session.interest_problem = ros2::Printable(in.answer.problem);
  alerts_.Raise(engine::Severity::kHigh, InterestProblem(*host));
}

std::string SensorSide::InterestProblem(const SensorHost& host) const {
  if (!IsPrimary(host) || !host.session) return "";
  const SensorSession& session = *host.session;
  if (session.interest_in_use == session.interest_wanted) return "";
  if (session.interest_problem.empty()) {
    return absl::StrCat("sensor ", host.name, " does not watch yet what the rules need");
  }
  return absl::StrCat("sensor ", host.name,
                      " does not watch what the rules need: ", session.interest_problem);
}

void SensorSide::GrantCredit(SensorHost& host) {
  SensorSession& session = *host.session;
  const Timing& timing = context_.timing;
  // Messages are judged against the graph: none are asked for before there is one.
  const uint64_t allowed = host.settled ? session.judged_bytes + timing.credit_bytes : 0;
  const uint64_t payloads =
      host.settled ? session.judged_payload_bytes + timing.payload_credit_bytes : 0;
  if (allowed < session.granted_bytes + timing.credit_bytes / 2 &&
      payloads < session.granted_payload_bytes + timing.payload_credit_bytes / 2 &&
      session.granted_bytes > 0) {
    return;
  }
  session.granted_bytes = std::max(session.granted_bytes, allowed);
  session.granted_payload_bytes = std::max(session.granted_payload_bytes, payloads);
  context_.Do(action::GrantCredit{.session = session.id,
                                  .message_bytes = session.granted_bytes,
                                  .payload_bytes = session.granted_payload_bytes});
}

SensorHost* SensorSide::Find(const std::string& host, SessionId session) {
  const auto it = hosts_.find(host);
  if (it == hosts_.end() || !it->second.session || it->second.session->id != session) {
    return nullptr;
  }
  return &it->second;
}

SensorHost* SensorSide::Hear(const std::string& host, SessionId session) {
  SensorHost* found = Find(host, session);
  if (found != nullptr) found->session->heard_ns = context_.now_ns();
  return found;
}

void SensorSide::OnHeartbeat(const input::SensorHeartbeat& in) {
  SensorHost* host = Hear(in.host, in.session);
  if (host == nullptr) return;
  SensorSession& session = *host->session;
  session.peer_boottime_ns = in.heartbeat.clock.boottime_ns;
  session.least_offset.Heartbeat(in.heartbeat.clock.boottime_ns, context_.now_ns());
  own_agents_.OnHeard(Named(*host));
  if (!session.skew.Heartbeat(in.heartbeat, context_.now())) return;
  alerts_.Raise(engine::Severity::kMedium,
                absl::StrCat("the wall clock of sensor ", in.host, " is off by about ",
                             *session.skew.estimate_ns() / kNanosPerMilli, " ms"));
  context_.events.push_back(engine::AgentEvent{.agent = "sensor", .state = "clock_skew"});
}

void SensorSide::OnGone(const std::string& host, SessionId session) {
  SensorHost* found = Find(host, session);
  if (found == nullptr) return;
  found->session.reset();
  found->gone_since_ns = context_.now_ns();
}

void SensorSide::Close(SensorHost& host, const absl::Status& why) {
  if (!host.session) return;
  context_.Do(action::Close{host.session->id, why});
  host.session.reset();
  host.gone_since_ns = context_.now_ns();
}

void SensorSide::RefuseGraph(SensorHost& host, const absl::Status& why) {
  host.graph_incarnation.clear();
  host.settled = false;
  Close(host, why);
}

void SensorSide::CheckLost() {
  for (auto& [name, host] : hosts_) {
    host.ForgetJudged();
    if (host.session && context_.now_ns() - host.session->heard_ns > context_.timing.lost_ns) {
      const int64_t heard_ns = host.session->heard_ns;
      Close(host, absl::DeadlineExceededError("no heartbeat"));
      host.gone_since_ns = heard_ns;
    }
    if (host.session || host.lost ||
        context_.now_ns() - host.gone_since_ns < context_.timing.lost_ns) {
      continue;
    }
    host.lost = true;
    alerts_.RaiseAbsence(
        absl::StrCat("sensor ", name, " is lost: ", context_.config.id, " is not watched"));
    context_.events.push_back(engine::AgentEvent{.agent = "sensor", .state = "lost"});
  }
}

void SensorSide::CloseAll(const absl::Status& why) {
  for (auto& [name, host] : hosts_) Close(host, why);
}

// A primary sensor that becomes another, or was another, starts its session anew: what it has to
// report differs.
void SensorSide::SetHosts(const RobotConfig& next) {
  const RobotConfig& config = context_.config;
  const auto kept_topics = context_.watch.kept_topics(context_.policy);
  if (next.sensor_settings != config.sensor_settings) {
    for (auto& [name, host] : hosts_) host.restarts.Expect(context_.now_ns() + kSettingsFollowedNs);
  }
  for (auto it = hosts_.begin(); it != hosts_.end();) {
    auto& [name, host] = *it;
    const bool listed = std::find(next.sensor_hosts.begin(), next.sensor_hosts.end(), name) !=
                        next.sensor_hosts.end();
    const bool part_changed =
        (name == next.primary_sensor) != (name == config.primary_sensor) ||
        (name == next.primary_sensor && next.graph_limits != config.graph_limits);
    if (!listed) {
      Close(host, absl::PermissionDeniedError(absl::StrCat("the inventory no longer lists sensor `",
                                                           name, "` of robot `", config.id, "`")));
      own_agents_.Forget(Named(host));
    } else if (part_changed) {
      Close(host, absl::AbortedError("its part in the inventory has changed"));
    }
    if (part_changed) host.BeginGraph(next.graph_limits, kept_topics);
    it = listed ? std::next(it) : hosts_.erase(it);
  }
  for (const std::string& name : next.sensor_hosts) {
    const auto [it, fresh] = hosts_.try_emplace(name);
    if (!fresh) continue;
    it->second.name = name;
    it->second.BeginGraph(next.graph_limits, kept_topics);
    it->second.gone_since_ns = context_.now_ns();
  }
}

void SensorSide::EchoHeartbeats() {
  for (const auto& [name, host] : hosts_) {
    if (!host.session) continue;
    context_.Do(action::EchoHeartbeat{.session = host.session->id,
                                      .echo_boottime_ns = host.session->peer_boottime_ns});
  }
}

void SensorSide::Acknowledge(const store::HighWater& judged) {
  // Of each session: what is new to it, or else one thing that is not, for its commit.
  std::map<SessionId, action::Acknowledge> known;
  std::set<SessionId> acknowledged;
  for (const auto& [key, sequence] : judged) {
    const auto it = hosts_.find(key.host);
    if (it == hosts_.end()) continue;
    SensorHost& host = it->second;
    const std::string incarnation = absl::HexStringToBytes(key.incarnation);
    const bool news = host.durable.Judged(incarnation, LaneOf(key)) < sequence;
    host.durable.Load(incarnation, LaneOf(key), sequence);
    if (!host.session) continue;
    action::Acknowledge acknowledge{.session = host.session->id,
                                    .incarnation = incarnation,
                                    .lane = LaneOf(key),
                                    .sequence = sequence,
                                    .commit = context_.store.commit};
    if (!news) {
      const bool own = incarnation == host.session->incarnation;
      const auto [at, fresh] = known.try_emplace(host.session->id, acknowledge);
      if (own && !fresh) at->second = std::move(acknowledge);
      continue;
    }
    acknowledged.insert(host.session->id);
    context_.Do(std::move(acknowledge));
  }
  for (auto& [session, acknowledge] : known) {
    if (!acknowledged.contains(session)) context_.Do(std::move(acknowledge));
  }
  for (auto& [name, host] : hosts_) host.durable.KeepOnly(host.sequences);
}

bool SensorSide::OnState(SensorHost& host, SensorStateSeen state, int64_t boottime_ns) {
  if (boottime_ns < host.state_boottime_ns) {
    // Of the backlog: what the sensor sees was said anew since then.
    state.not_visible = host.state.not_visible;
    state.blind = host.state.blind;
  } else {
    host.state_boottime_ns = boottime_ns;
  }
  const bool was_overloaded = std::exchange(host.state, std::move(state)).overloaded;
  if (!host.state.overloaded) return false;
  evidence_.Disturb("the sensor is overloaded", context_.now());
  return !was_overloaded;
}

SensorHost* SensorSide::Listed(const std::string& host) {
  const auto it = hosts_.find(host);
  return it == hosts_.end() ? nullptr : &it->second;
}

std::string SensorSide::DoubtOf(const SensorHost& host) const {
  return own_agents_.DoubtOf(Named(host));
}

void SensorSide::AddProblems(std::vector<std::string>& problems) const {
  for (const auto& [name, host] : hosts_) {
    if (!host.session) {
      problems.push_back(absl::StrCat("sensor ", name, " is not connected"));
      continue;
    }
    if (context_.now_ns() - host.session->heard_ns > context_.timing.stale_ns) {
      problems.push_back(absl::StrCat("sensor ", name, " is silent"));
    }
    if (std::string doubt = DoubtOf(host); !doubt.empty()) problems.push_back(std::move(doubt));
    if (std::string problem = InterestProblem(host); !problem.empty()) {
      problems.push_back(std::move(problem));
    }
    if (IsPrimary(host) && !host.settled) {
      problems.push_back(absl::StrCat("the graph of sensor ", name, " has not settled"));
    }
    if (host.HasBacklog()) {
      problems.push_back(absl::StrCat("observations of sensor ", name, " are not judged yet"));
    }
  }
}

bool SensorSide::HasBacklog() const {
  return std::any_of(hosts_.begin(), hosts_.end(),
                     [](const auto& sensor) { return sensor.second.HasBacklog(); });
}

bool SensorSide::Connected(const SensorHost& host) const {
  return host.session && context_.now_ns() - host.session->heard_ns <= context_.timing.stale_ns;
}

bool SensorSide::connected() const {
  return std::all_of(hosts_.begin(), hosts_.end(),
                     [&](const auto& sensor) { return Connected(sensor.second); });
}

bool SensorSide::complete() const {
  return std::all_of(hosts_.begin(), hosts_.end(), [&](const auto& sensor) {
    const SensorHost& host = sensor.second;
    return Connected(host) && (host.settled || !IsPrimary(host)) && !host.HasBacklog();
  });
}

void SensorSide::AddHighWater(store::HighWater& judged) const {
  for (const auto& [name, host] : hosts_) {
    store::HighWater news;
    store::HighWater stored;
    for (const auto& [key, sequence] : host.sequences.all()) {
      const auto& [incarnation, of_lane] = key;
      const auto lane = of_lane == Lane::kControl ? store::LaneKey::Lane::kControl
                                                  : store::LaneKey::Lane::kMessages;
      const bool is_news = host.durable.Judged(incarnation, of_lane) < sequence;
      (is_news ? news : stored)[{
          .host = name, .incarnation = absl::BytesToHexString(incarnation), .lane = lane}] =
          sequence;
    }
    // What is written is acknowledged, and with it the commit.
    judged.merge(news.empty() ? stored : news);
  }
}

}  // namespace rips::pipeline
