// Robot: what sensors say.
#include <algorithm>
#include <utility>
#include <variant>

#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/robot.h"
#include "services/base/overloaded.h"

namespace rips::pipeline {
namespace {

void Count(const std::function<void(uint64_t)>& counter, uint64_t by) {
  if (counter && by > 0) counter(by);
}

engine::LossEvent ToEvent(const LossSeen& loss, const SensorSession& session) {
  const auto unix_ns = [&](int64_t boottime_ns) {
    return boottime_ns == 0 ? 0 : boottime_ns + session.unix_offset_ns;
  };
  return {.count = loss.count,
          .topic = loss.topic,
          .type = loss.type,
          .writer = loss.writer,
          .first_unix_ns = unix_ns(loss.first_boottime_ns),
          .last_unix_ns = unix_ns(loss.last_boottime_ns),
          .cause = loss.cause};
}

}  // namespace

void Robot::OnSensorHello(const std::string& host_name, std::shared_ptr<SensorLink> link,
                          const SensorHello& hello) {
  const auto it = sensors_.find(host_name);
  if (it == sensors_.end()) {
    return link->Close(absl::PermissionDeniedError(absl::StrCat(
        "the inventory lists no sensor `", host_name, "` of robot `", config_.id, "`")));
  }
  SensorHost& host = it->second;
  const Instant now = ports_.clock->Now();
  if (host.session) {
    if (now.boottime_ns - host.session->heard_ns < timing_.stale_ns) {
      RefuseSecond(host.second, hello.peer);
      return link->Close(absl::AlreadyExistsError(
          absl::StrCat("sensor ", config_.id, "/", host_name, " has a live session")));
    }
    host.session->link->Close(absl::AbortedError("replaced by a newer session"));
  }
  BeginSession("sensor", host_name, host.second, hello.peer);
  host.session = SensorSession{
      .link = std::move(link),
      .incarnation = hello.incarnation,
      .boottime_offset_ns = now.boottime_ns - hello.clock.boottime_ns,
      .unix_offset_ns = now.unix_ns - hello.clock.boottime_ns,
      .heard_ns = now.boottime_ns,
      .peer_boottime_ns = hello.clock.boottime_ns,
      .domain = hello.domain,
      .spooled = hello.spooled,
      .interest_in_use = hello.interest_in_use,
  };
  SensorSession& session = *host.session;
  findings_.OnIncarnation(host_name, hello.incarnation, now.boottime_ns);
  if (host.graph_incarnation != hello.incarnation) host.settled = false;
  const uint64_t missing = LostBefore(host, hello);
  TakeHello(host, hello, now);
  SendSetup(host_name, host, session);
  GrantCredit(host, session);
  // Not what is judged: its alerts may still wait for the disk.
  const store::StorePoint point = ports_.recorder->point();
  for (const SpooledRange& range : hello.spooled) {
    session.link->Acknowledge(range.incarnation, range.lane,
                              host.durable.Judged(range.incarnation, range.lane), point.commit);
  }
  evidence_.Disturb(absl::StrCat("sensor ", host_name, " connected"), now);
  if (missing > 0) Missing(host, missing);
  if (host.lost) {
    OwnAlert(engine::Severity::kInfo, absl::StrCat("sensor ", host_name, " is back"));
  }
  host.lost = false;
  External(engine::AgentEvent{.agent = "sensor", .state = "connected"});
  UpdateActuation(now);
  Flush();
  PublishStatus();
}

void Robot::SendSetup(const std::string& host_name, SensorHost& host, SensorSession& session) {
  const bool primary = host_name == config_.primary_sensor;
  session.link->Setup({.linger_ms = timing_.linger_ms,
                       .own_participants = Participants(),
                       .protected_parts = ProtectedParts(),
                       .primary = primary,
                       .want_snapshot = primary && host.graph_incarnation != session.incarnation,
                       .store = ports_.recorder->point()});
  if (primary) AskInterest(session);
}

void Robot::GrantCredit(SensorHost& host, SensorSession& session) {
  // Messages are judged against the graph: none are asked for before there is one.
  const uint64_t allowed = host.settled ? session.judged_bytes + timing_.credit_bytes : 0;
  const uint64_t payloads =
      host.settled ? session.judged_payload_bytes + timing_.payload_credit_bytes : 0;
  if (allowed < session.granted_bytes + timing_.credit_bytes / 2 &&
      payloads < session.granted_payload_bytes + timing_.payload_credit_bytes / 2 &&
      session.granted_bytes > 0) {
    return;
  }
  session.granted_bytes = std::max(session.granted_bytes, allowed);
  session.granted_payload_bytes = std::max(session.granted_payload_bytes, payloads);
  session.link->Grant(session.granted_bytes, session.granted_payload_bytes);
}

SensorSession* Robot::SessionOf(const std::string& host, const SensorLink* link) {
  const auto it = sensors_.find(host);
  if (it == sensors_.end() || !it->second.session || it->second.session->link.get() != link) {
    return nullptr;
  }
  return &*it->second.session;
}

SensorSession* Robot::HearSensor(const std::string& host, const SensorLink* link) {
  SensorSession* session = SessionOf(host, link);
  if (session != nullptr) session->heard_ns = ports_.clock->Now().boottime_ns;
  return session;
}

void Robot::OnBatch(const std::string& host, const SensorLink* link,
                    std::shared_ptr<const Batch> batch) {
  SensorSession* session = HearSensor(host, link);
  if (session == nullptr) return;
  if (batch->lane == Lane::kControl) {
    control_line_.batches.push_back(
        {.host = host, .link = session->link, .batch = std::move(batch)});
    return AdvanceControl();
  }
  message_line_.batches.push_back({.ticket = ++message_line_.last_ticket,
                                   .host = host,
                                   .link = session->link,
                                   .batch = std::move(batch),
                                   .arrived_ns = ports_.clock->Now().boottime_ns});
  AdvanceMessages();
}

void Robot::JudgeBatch(const std::string& host_name, const SensorLink* link, const Batch& batch,
                       size_t from, size_t to,
                       const std::vector<std::vector<engine::Verdict>>& verdicts) {
  SensorSession* session = SessionOf(host_name, link);
  if (session == nullptr) return;
  SensorHost& host = sensors_[host_name];
  const auto accepted =
      host.sequences.Accept(batch.incarnation, batch.lane, batch.first_sequence + from, to - from);
  if (!accepted.ok()) {
    session->link->Close(accepted.status());
    return OnSensorGone(host_name, link);
  }
  const Instant now = ports_.clock->Now();
  if (accepted->missing > 0) Missing(host, accepted->missing);
  Count(ports_.counts.observations_duplicate, accepted->skip);
  outbox_.TouchSequences();
  for (size_t i = from + accepted->skip; i < to; ++i) {
    const absl::Span<const engine::Verdict> inspections =
        i < verdicts.size() ? verdicts[i] : absl::Span<const engine::Verdict>();
    const auto* finding = std::get_if<FindingSeen>(&batch.observations[i].what);
    if (finding != nullptr && !TakeFinding(host_name, batch.incarnation, *finding)) continue;
    Judge(host, *session, host_name == config_.primary_sensor, batch, i, inspections);
    // Judging may have ended the session (a graph that contradicts itself).
    if (!host.session || host.session->link.get() != link) break;
  }
  Count(ports_.counts.observations_judged, to - from - accepted->skip);
  if (host.session && host.session->link.get() == link) {
    const bool whole = to == batch.observations.size();
    if (batch.lane == Lane::kMessages && whole) {
      host.session->judged_bytes += batch.bytes;
      host.session->judged_payload_bytes += batch.payload_bytes;
    }
    GrantCredit(host, *host.session);
  }
  UpdateActuation(now);
  if (outbox_.due()) Flush();
}

void Robot::Missing(SensorHost& host, uint64_t count) {
  CountLost(host, count);
  loss_alarm_.Add("they have a number and did not come", count, ports_.clock->Now().boottime_ns);
  evidence_.Disturb(absl::StrCat(count, " observations have a number and did not come"),
                    ports_.clock->Now());
  External(engine::LossEvent{.count = count});
}

void Robot::Judge(SensorHost& host, SensorSession& session, bool primary, const Batch& batch,
                  size_t index, absl::Span<const engine::Verdict> inspections) {
  const Observation& seen = batch.observations[index];
  // The graph of an incarnation that is over leads nowhere.
  const bool has_graph = primary && batch.incarnation == session.incarnation;
  const Instant now = ports_.clock->Now();
  const int64_t age_ns = now.boottime_ns - (seen.boottime_ns + session.boottime_offset_ns);
  if (age_ns > timing_.backlog_ns) {
    evidence_.Disturb("observations were judged more than a second after they were taken", now);
  }
  engine::Event event{
      .what = engine::GraphEvent{},
      .time_unix_ns = std::min(seen.boottime_ns + session.unix_offset_ns, now.unix_ns),
      .lateness =
          age_ns > timing_.late_after_ns ? levels::Lateness::kLate : levels::Lateness::kTimely};
  const auto run = [&](engine::ExternalEvent external) {
    event.what = std::move(external);
    Run(event);
  };
  const auto judge_graph = [&] {
    if (has_graph) JudgeGraph(host, session, batch, seen, std::move(event));
  };
  std::visit(
      Overloaded{[&](const MessageSeen& message) {
                   if (!primary) return;
                   CountCut(message);
                   JudgeMessage(host, batch, message, std::move(event), inspections);
                 },
                 [&](const GraphSnapshotSeen&) { judge_graph(); },
                 [&](const GraphDeltaSeen&) { judge_graph(); },
                 [&](const IdsAlertSeen& ids) {
                   run(engine::IdsEvent{.message = ids.message,
                                        .gid = ids.gid,
                                        .sid = ids.sid,
                                        .line = ids.line,
                                        .source = ids.source,
                                        .target = ids.target});
                 },
                 [&](const SignalSeen& signal) { run(engine::SignalEvent{.name = signal.name}); },
                 [&](const LossSeen& loss) {
                   CountLost(host, loss.count);
                   if (!loss.tolerable) {
                     loss_alarm_.Add(loss.cause, loss.count, now.boottime_ns);
                     evidence_.Disturb(
                         absl::StrCat(loss.count, " observations were lost: ", loss.cause), now);
                   }
                   run(ToEvent(loss, session));
                 },
                 [&](const SensorStateSeen& state) {
                   if (!TakeState(host, state, seen.boottime_ns)) return;
                   run(engine::AgentEvent{.agent = "sensor", .state = "overloaded"});
                 },
                 [&](const FindingSeen& finding) {
                   run(engine::FindingEvent{.kind = finding.kind,
                                            .guid = finding.guid,
                                            .node = finding.node,
                                            .topic = finding.topic,
                                            .detail = finding.detail});
                 }},
      seen.what);
}

void Robot::JudgeGraph(SensorHost& host, SensorSession& session, const Batch& batch,
                       const Observation& seen, engine::Event event) {
  bool news = true;
  absl::Status status;
  if (const auto* snapshot = std::get_if<GraphSnapshotSeen>(&seen.what)) {
    status = host.TakeSnapshot(session.incarnation, *snapshot);
  } else {
    // Until a snapshot of this incarnation has come, deltas have nothing to change: the snapshot
    // will contain them.
    if (host.graph_incarnation != session.incarnation) return;
    const auto& delta = std::get<GraphDeltaSeen>(seen.what);
    news = delta.to_version > host.graph_version;
    status = host.TakeDelta(session.incarnation, delta);
  }
  if (!status.ok()) return RefuseGraph(host, session, status);
  if (!news || !host.settled || MergesGraph(batch, event, seen.boottime_ns)) return;
  GraphChanged(host, std::move(event));
}

void Robot::RefuseGraph(SensorHost& host, const SensorSession& session,
                        const absl::Status& status) {
  // The next stream starts with a snapshot.
  host.graph_incarnation.clear();
  host.settled = false;
  const std::shared_ptr<SensorLink> link = session.link;
  link->Close(status);
  for (auto& [name, other] : sensors_) {
    if (&other == &host) return OnSensorGone(name, link.get());
  }
}

void Robot::GraphChanged(SensorHost& host, engine::Event event) {
  state_.graph = host.graph;
  graph_history_.Add(host.graph_incarnation, host.graph_version, state_.graph.version(),
                     ports_.clock->Now().boottime_ns);
  graph_changed_unix_ns_ = event.time_unix_ns;
  // A graph that shows nobody must not lower a level in the very event that shows it.
  UpdateBlind(ports_.clock->Now());
  UpdateEvidence(ports_.clock->Now());
  event.what = engine::GraphEvent{};
  Run(event);
  if (host.session) GrantCredit(host, *host.session);
}

void Robot::OnSensorGone(const std::string& host_name, const SensorLink* link) {
  const auto it = sensors_.find(host_name);
  if (it == sensors_.end() || !it->second.session || it->second.session->link.get() != link) return;
  const Instant now = ports_.clock->Now();
  it->second.session.reset();
  it->second.gone_since_ns = now.boottime_ns;
  UpdateEvidence(now);
  PublishStatus();
}

void Robot::CheckSensors(Instant now) {
  for (auto& [name, host] : sensors_) {
    if (host.session && now.boottime_ns - host.session->heard_ns > timing_.lost_ns) {
      host.session->link->Close(absl::DeadlineExceededError("no heartbeat"));
      host.gone_since_ns = host.session->heard_ns;
      host.session.reset();
    }
    if (host.session || host.lost || now.boottime_ns - host.gone_since_ns < timing_.lost_ns) {
      continue;
    }
    host.lost = true;
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat("sensor ", name, " is lost: ", config_.id, " is not watched"));
    External(engine::AgentEvent{.agent = "sensor", .state = "lost"});
  }
}

}  // namespace rips::pipeline
