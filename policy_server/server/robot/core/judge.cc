#include "policy_server/server/robot/core/judge.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "services/base/overloaded.h"

namespace rips::pipeline {
namespace {

// With its times on the clock of events.
LossSeen EventOf(LossSeen loss, const SensorSession& session) {
  for (int64_t* at_ns : {&loss.first_ns, &loss.last_ns}) {
    if (*at_ns != 0) *at_ns += session.unix_offset_ns;
  }
  return loss;
}

// On the server's clock; nullopt if that is not known.
std::optional<int64_t> TakenAt(const SensorHost& host, const Batch& batch, size_t index) {
  const std::optional<int64_t> offset_ns = host.session->least_offset.ns();
  if (!offset_ns || batch.incarnation != host.session->incarnation) return std::nullopt;
  return batch.observations[index].boottime_ns + *offset_ns;
}

// The sensor whose graph and messages count.
bool IsPrimary(const SensorHost& host, const Context& context) {
  return host.name == context.config.primary_sensor;
}

}  // namespace

void Judge::OnBatch(const input::SensorBatch& in) {
  if (parts_.sensors.Hear(in.host, in.session) == nullptr) return;
  WaitingBatch batch{.host = in.host, .session = in.session, .batch = in.batch};
  if (in.batch->lane == Lane::kControl) {
    control_.Push(std::move(batch));
  } else {
    messages_.Push(std::move(batch));
  }
}

void Judge::Clear() {
  control_.Clear();
  messages_.Clear();
}

void Judge::OnTime() {
  messages_.Expire(parts_.sensors.HasBacklog());
  late_.LookAgain(parts_.sensors.Listed(parts_.context.config.primary_sensor));
}

void Judge::Advance() {
  if (has_control()) return AdvanceControl();
  if (has_messages()) AdvanceMessages();
}

void Judge::AdvanceControl() {
  const WaitingBatch& first = control_.first();
  SensorHost* host = parts_.sensors.Find(first.host, first.session);
  if (host != nullptr && !first.whole()) JudgePiece(*host, control_.Next());
  host = parts_.sensors.Find(first.host, first.session);
  if (host != nullptr && !first.whole()) return;
  // What a stream that has ended leaves here was not acknowledged and will be sent again; a graph
  // that was applied will not.
  const std::string name = first.host;
  std::optional<engine::Event> merged = control_.Pop();
  SensorHost* listed = parts_.sensors.Listed(name);
  const bool late = late_.WasHeldBack();
  if (merged && late) {
    late_.Judge(*std::move(merged));
  } else if (merged && listed != nullptr && listed->settled) {
    OnGraph(*listed, *std::move(merged), nullptr);
  }
}

void Judge::AdvanceMessages() {
  const WaitingBatch& first = messages_.first();
  SensorHost* host = parts_.sensors.Find(first.host, first.session);
  if (host != nullptr && !first.whole()) {
    const std::optional<Piece> piece = messages_.Next(*host);
    if (!piece) return;
    JudgePiece(*host, *piece);
    host = parts_.sensors.Find(first.host, first.session);
  }
  if (host != nullptr && !first.whole()) return;
  messages_.Pop();
}

void Judge::JudgePiece(SensorHost& host, const Piece& piece) {
  const Batch& batch = *piece.waiting.batch;
  const auto accepted = host.sequences.Accept(
      batch.incarnation, batch.lane, batch.first_sequence + piece.from, piece.to - piece.from);
  if (!accepted.ok()) return parts_.sensors.Close(host, accepted.status());
  if (accepted->missing > 0) parts_.losses.OnMissing(host, accepted->missing);
  parts_.decider.RunEvents();
  parts_.context.Count(Counter::kObservationsDuplicate, accepted->skip);
  parts_.outbox.Touch(&DurableOutbox::Unsaved::sequences);
  const bool former =
      batch.incarnation != host.session->incarnation && IsPrimary(host, parts_.context);
  for (size_t i = piece.from; former && i < piece.from + accepted->skip; ++i) {
    // What comes after it needs it.
    const auto* change = std::get_if<GraphChange>(&batch.observations[i].what);
    if (change != nullptr) late_.Apply(host, batch.incarnation, *change);
  }
  std::shared_ptr<const Batch> keeps = piece.waiting.batch;
  for (size_t i = piece.from + accepted->skip; i < piece.to; ++i) {
    const auto* finding = std::get_if<FindingSeen>(&batch.observations[i].what);
    if (finding != nullptr && !parts_.findings.OnFinding(host.name, batch.incarnation, *finding)) {
      continue;
    }
    JudgeOne(host, piece, i, keeps);
    // Judging may have ended the session (a graph that contradicts itself).
    if (!host.session) break;
  }
  parts_.context.Count(Counter::kObservationsJudged, piece.to - piece.from - accepted->skip);
  if (!host.session) return;
  if (batch.lane == Lane::kMessages && piece.to == batch.observations.size()) {
    host.session->judged_bytes += batch.bytes;
    host.session->judged_payload_bytes += batch.payload_bytes;
  }
  parts_.sensors.GrantCredit(host);
}

void Judge::JudgeOne(SensorHost& host, const Piece& piece, size_t index,
                     std::shared_ptr<const Batch>& keeps) {
  const Batch& batch = *piece.waiting.batch;
  const Observation& seen = batch.observations[index];
  const SensorSession& session = *host.session;
  const bool primary = IsPrimary(host, parts_.context);
  const Instant now = parts_.context.now();
  const int64_t age_ns = now.boottime_ns - (seen.boottime_ns + session.boottime_offset_ns);
  if (age_ns > parts_.context.timing.backlog_ns) {
    parts_.gate.Disturb("observations were judged more than a second after they were taken", now);
  }
  engine::Event event{
      .what = engine::GraphEvent{},
      .time_unix_ns = std::min(seen.boottime_ns + session.unix_offset_ns, now.unix_ns),
      .lateness = age_ns > parts_.context.timing.late_after_ns ? levels::Lateness::kLate
                                                               : levels::Lateness::kTimely};
  const auto run = [&](engine::ExternalEvent external) {
    event.what = std::move(external);
    parts_.decider.Run(event);
  };
  std::visit(Overloaded{[&](const MessageSeen&) {
                          if (primary) JudgeMessage(host, piece, index, std::move(event), keeps);
                        },
                        [&](const GraphChange& change) {
                          if (!primary) return;
                          if (batch.incarnation != session.incarnation) {
                            return JudgeFormerGraph(host, batch, seen, event);
                          }
                          JudgeGraph(host, piece, change, seen.boottime_ns, event);
                        },
                        [&](const LossSeen& loss) {
                          if (!loss.topic.empty() && !Concerns(loss.topic)) {
                            event.what = engine::ExternalEvent(EventOf(loss, session));
                            parts_.decider.Run(event, {.muted = true});
                            return;
                          }
                          parts_.losses.OnLoss(host, loss);
                          run(EventOf(loss, session));
                        },
                        [&](const SensorStateSeen& state) {
                          const bool overloaded =
                              parts_.sensors.OnState(host, state, seen.boottime_ns);
                          parts_.sight.OnState(host);
                          if (batch.incarnation == session.incarnation) {
                            parts_.findings.OnState(host, state);
                          }
                          parts_.evidence.Update();
                          if (overloaded)
                            run(engine::AgentEvent{.agent = "sensor", .state = "overloaded"});
                        },
                        [&](const auto& external) { run(external); }},
             seen.what);
}

void Judge::JudgeMessage(SensorHost& host, const Piece& piece, size_t index, engine::Event event,
                         std::shared_ptr<const Batch>& keeps) {
  const Batch& batch = *piece.waiting.batch;
  const auto& message = std::get<MessageSeen>(batch.observations[index].what);
  const bool concerns = Concerns(message.topic);
  if (concerns) parts_.sight.OnMessage(message);
  const GraphHistory::Choice choice = messages_.Choose(host, batch, message);
  engine::MessageEvent judged = InspectionLine::EventOf(message, choice);
  if (LevelWitness& witness = parts_.actuators.witness(); witness.Watches(judged.sender)) {
    const auto taken_ns = TakenAt(host, batch, index);
    if (taken_ns) {
      witness.OnMessage({message.topic, judged.sender, message.writer, *taken_ns},
                        parts_.context.now_ns());
    }
  }
  if (index < piece.verdicts.size()) judged.inspections = piece.verdicts[index];
  event.what = judged;
  // One action keeps the batch alive: counting its owners for each message costs more. Not a muted
  // one, which not all recorders are given.
  const Source source = {.message = &message,
                         .batch = concerns ? std::exchange(keeps, nullptr) : keeps,
                         .remark = messages_.Remark(message, choice),
                         .muted = !concerns};
  engine::CurrentGraph& graph = parts_.state.graph;
  if (choice.version->revision == graph.revision()) {
    parts_.decider.Run(event, source);
    return;
  }
  const engine::CurrentGraph::Version newest = graph.version();
  graph.Show(*choice.version);
  if (parts_.decider.Run(event, source)) late_.OnKept();
  graph.Show(newest);
}

void Judge::JudgeGraph(SensorHost& host, const Piece& piece, const GraphChange& change,
                       int64_t boottime_ns, engine::Event event) {
  const std::string& incarnation = host.session->incarnation;
  const bool next = !change.whole() && in_force_ == InForce{incarnation, change.from_version};
  bool news = true;
  absl::Status status;
  if (change.whole()) {
    status = host.ApplySnapshot(incarnation, change);
  } else {
    // Until a snapshot of this incarnation has come, deltas have nothing to change: the snapshot
    // will contain them.
    if (host.graph_incarnation != incarnation) return;
    news = change.to_version > host.graph_version;
    status = host.ApplyDelta(incarnation, change);
  }
  if (!status.ok()) return parts_.sensors.RefuseGraph(host, status);
  parts_.findings.Update();
  if (!news) return;
  in_force_.reset();
  const std::shared_ptr<const Batch>& batch = piece.waiting.batch;
  const bool control = batch->lane == Lane::kControl;
  if (!host.settled || (control && control_.Merges(event, boottime_ns))) return;
  OnGraph(host, std::move(event), next ? batch : nullptr);
}

void Judge::JudgeFormerGraph(SensorHost& host, const Batch& batch, const Observation& seen,
                             engine::Event event) {
  const GraphChange& change = std::get<GraphChange>(seen.what);
  if (batch.lane != Lane::kControl) return;
  if (!late_.Apply(host, batch.incarnation, change)) {
    const LossSeen loss{
        .count = 1,
        .first_ns = seen.boottime_ns,
        .last_ns = seen.boottime_ns,
        .cause = "changes of the graph before the sensor was started anew do not fit one another"};
    parts_.losses.OnLoss(host, loss);
    event.what = engine::ExternalEvent(EventOf(loss, *host.session));
    parts_.decider.Run(event);
    return;
  }
  // It may have been judged when that incarnation told it.
  if (!late_.settled() || in_force_ == InForce{batch.incarnation, change.to_version}) return;
  if (control_.Merges(event, seen.boottime_ns)) return late_.HoldBack();
  late_.Judge(std::move(event));
}

void Judge::OnGraph(SensorHost& host, engine::Event event, std::shared_ptr<const Batch> told_by) {
  parts_.state.graph = host.graph;
  in_force_ = {.incarnation = host.graph_incarnation, .version = host.graph_version};
  messages_.OnGraph(host);
  graph_changed_unix_ns_ = event.time_unix_ns;
  // A graph that shows no node must not lower a level in the very event that shows it.
  parts_.sight.Update();
  parts_.findings.Update();
  parts_.evidence.Update();
  event.what = engine::GraphEvent{};
  // The rules may have been run on a former graph since the one before.
  if (late_.look_again()) told_by = nullptr;
  parts_.decider.Run(event, {.batch = std::move(told_by), .remark = ""});
  late_.OnLook(host);
  if (host.session) parts_.sensors.GrantCredit(host);
}

}  // namespace rips::pipeline
