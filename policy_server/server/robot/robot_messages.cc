// Robot: the message lane. Batches wait here, in order, until each message has been inspected and
// the graph is in force under which it was taken. The control lane never waits.
#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/robot.h"

namespace rips::pipeline {
namespace {

// A turn ends after the batch during which it has lasted so long, from its second batch on.
constexpr int64_t kMessagesTurnNs = 2 * kNanosPerMilli;
// Answers that one robot waits for at a time; inspectors keep a short line for each robot.
constexpr size_t kAskedMax = 32;

// As of the graph that was chosen for it.
engine::MessageEvent ToEvent(const MessageSeen& message, const GraphHistory::Choice& choice) {
  absl::string_view sender = message.sender;
  if (choice.writer != nullptr) {
    sender = choice.writer->node;
  } else if (choice.wait || choice.unattributed) {
    sender = "";
  }
  return {.topic = message.topic,
          .type = message.type,
          .writer = message.writer,
          .sender = sender,
          .size_bytes = message.size_bytes,
          .memo = message.memo};
}

}  // namespace

void Robot::AdvanceMessages() {
  // An answer may come while a question is being asked.
  if (message_line_.advancing) return;
  message_line_.advancing = true;
  message_line_.unfinished = false;
  // 0 = in the first batch, whose time is not asked.
  int64_t end_ns = 0;
  while (!message_line_.batches.empty()) {
    WaitingBatch& first = message_line_.batches.front();
    const size_t size = first.batch->observations.size();
    while (first.judged < size && SessionOf(first.host, first.link.get()) != nullptr) {
      const size_t from = first.judged;
      first.judged = AskInspections(first);
      if (first.judged == from) break;
      JudgeBatch(first.host, first.link.get(), *first.batch, from, first.judged, first.verdicts);
    }
    if (first.judged < size && SessionOf(first.host, first.link.get()) != nullptr) break;
    // What a stream that has ended leaves here was not acknowledged and will be sent again.
    message_line_.batches.pop_front();
    if (message_line_.batches.empty()) break;
    const int64_t now_ns = ports_.clock->Now().boottime_ns;
    if (end_ns == 0) end_ns = now_ns + kMessagesTurnNs;
    message_line_.unfinished = now_ns >= end_ns;
    if (message_line_.unfinished) break;
  }
  message_line_.advancing = false;
}

size_t Robot::AskInspections(WaitingBatch& batch) {
  const std::shared_ptr<const engine::CompiledPolicy>& program = state_.program();
  const std::vector<Observation>& observations = batch.batch->observations;
  const bool inspects =
      !program->rules().inspections.empty() && batch.host == config_.primary_sensor;
  if (batch.program != program) {
    // New, or asked under rules that are no longer in force.
    batch.program = program;
    batch.ticket = ++message_line_.last_ticket;
    batch.verdicts.assign(inspects ? observations.size() : 0, {});
    batch.asked = batch.judged;
    batch.waiting = 0;
  }
  const Instant now = ports_.clock->Now();
  while (batch.asked < observations.size() && batch.waiting < kAskedMax) {
    const auto* message = std::get_if<MessageSeen>(&observations[batch.asked].what);
    if (message != nullptr && !KnowsGraph(batch, *message)) break;
    const size_t index = batch.asked++;
    if (!inspects || message == nullptr) continue;
    engine::Event event;
    event.what = ToEvent(*message, ChooseGraph(sensors_[batch.host], *batch.batch, *message));
    std::vector<uint32_t> needed = engine::NeededInspections(event, now, state_);
    if (!needed.empty()) AskInspection(batch, index, std::move(needed));
  }
  return batch.waiting == 0 ? batch.asked : batch.judged;
}

void Robot::AskInspection(WaitingBatch& batch, size_t index, std::vector<uint32_t> needed) {
  const Observation& seen = batch.batch->observations[index];
  const auto& message = std::get<MessageSeen>(seen.what);
  batch.verdicts[index].assign(batch.program->rules().inspections.size(),
                               engine::Verdict::kUnscanned);
  if (policy_.inspector == nullptr) return CountSkipped(message, needed.size());
  ++batch.waiting;
  const SensorHost& host = sensors_[batch.host];
  const engine::MessageEvent event = ToEvent(message, ChooseGraph(host, *batch.batch, message));
  const InspectedMessage inspected{
      .topic = event.topic,
      .type = event.type,
      .sender = event.sender,
      .writer = event.writer,
      .time_unix_ns = seen.boottime_ns + (host.session ? host.session->unix_offset_ns : 0),
      .payload = message.payload,
      .size_bytes = message.size_bytes,
      .owner = batch.batch};
  policy_.inspector->Inspect(config_.id, needed, inspected,
                             [this, post = ports_.post_work, ticket = batch.ticket, index,
                              needed](std::vector<engine::Verdict> verdicts) {
                               post([this, ticket, index, needed, verdicts = std::move(verdicts)] {
                                 OnInspected(ticket, index, needed, verdicts);
                               });
                             });
}

void Robot::OnInspected(uint64_t ticket, size_t index, const std::vector<uint32_t>& asked,
                        const std::vector<engine::Verdict>& verdicts) {
  if (message_line_.batches.empty() || message_line_.batches.front().ticket != ticket) return;
  WaitingBatch& batch = message_line_.batches.front();
  for (size_t i = 0; i < asked.size() && i < verdicts.size(); ++i) {
    batch.verdicts[index][asked[i]] = verdicts[i];
  }
  const auto skipped = static_cast<uint64_t>(
      std::count(verdicts.begin(), verdicts.end(), engine::Verdict::kUnscanned));
  CountSkipped(std::get<MessageSeen>(batch.batch->observations[index].what), skipped);
  --batch.waiting;
  AdvanceMessages();
}

GraphHistory::Choice Robot::ChooseGraph(const SensorHost& host, const Batch& batch,
                                        const MessageSeen& message) const {
  const bool live = host.session && host.session->incarnation == batch.incarnation;
  return graph_history_.Choose(batch.incarnation, live, message.graph_version, message.writer,
                               state_.graph.version());
}

bool Robot::KnowsGraph(const WaitingBatch& batch, const MessageSeen& message) {
  if (batch.host != config_.primary_sensor) return true;
  if (!ChooseGraph(sensors_[batch.host], *batch.batch, message).wait) return true;
  if (ports_.clock->Now().boottime_ns - batch.arrived_ns < timing_.graph_wait_ns) return false;
  graph_history_.GiveUp(message.writer);
  if (ports_.counts.messages_unattributed) ports_.counts.messages_unattributed(1);
  return true;
}

void Robot::JudgeMessage(SensorHost& host, const Batch& batch, const MessageSeen& message,
                         engine::Event event, absl::Span<const engine::Verdict> inspections) {
  const GraphHistory::Choice choice = ChooseGraph(host, batch, message);
  engine::MessageEvent judged = ToEvent(message, choice);
  judged.inspections = inspections;
  event.what = judged;
  std::string remark;
  if (choice.wait || choice.unattributed) {
    remark =
        absl::StrCat(" (no node is known: the graph did not show its writer within ",
                     timing_.graph_wait_ns / kNanosPerMilli, " ms; version ", message.graph_version,
                     " was to show it, version ", graph_history_.number(), " is in force)");
  }
  if (choice.version->revision == state_.graph.revision()) return Run(event, &message, remark);
  const engine::CurrentGraph::Version newest = state_.graph.version();
  state_.graph.Show(*choice.version);
  Run(event, &message, remark);
  state_.graph.Show(newest);
}

}  // namespace rips::pipeline
