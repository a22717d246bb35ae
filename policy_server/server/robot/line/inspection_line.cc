#include "policy_server/server/robot/line/inspection_line.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace rips::pipeline {
namespace {

// Answers that one robot waits for at a time; inspectors keep a short line for each robot.
constexpr size_t kAskedMax = 32;

}  // namespace

engine::MessageEvent InspectionLine::EventOf(const MessageSeen& message,
                                             const GraphHistory::Choice& choice) {
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

std::string InspectionLine::Remark(const MessageSeen& message,
                                   const GraphHistory::Choice& choice) const {
  if (choice.outlived) {
    return " (it came late, and who was there when it was taken is not known: it was judged by "
           "who is there now, and its writer)";
  }
  if (!choice.wait && !choice.unattributed) return "";
  return absl::StrCat(" (no node is known: the graph did not show its writer within ",
                      context_.timing.graph_wait_ns / kNanosPerMilli, " ms; version ",
                      message.graph_version, " was to show it, version ", history_.number(),
                      " is in force)");
}

void InspectionLine::Push(WaitingBatch batch) {
  batches_.push_back({.waiting = std::move(batch),
                      .arrived_ns = context_.now_ns(),
                      .ticket = ++last_ticket_,
                      .program = nullptr,
                      .verdicts = {}});
  ready_ = true;
}

void InspectionLine::OnGraph(const SensorHost& host) {
  history_.Add(host.graph_incarnation, host.graph_version, state_.graph.version(),
               context_.now_ns());
  ready_ = true;
}

GraphHistory::Choice InspectionLine::Choose(const SensorHost& host, const Batch& batch,
                                            const MessageSeen& message) {
  const bool live = host.session && host.session->incarnation == batch.incarnation;
  GraphHistory::Choice choice =
      history_.Choose(batch.incarnation, live, message.graph_version, message.writer,
                      state_.graph.version(), former_.Of(batch.incarnation, message.graph_version));
  if (live || choice.writer != nullptr || message.writer.none() ||
      !context_.watch.Concerns(message.topic)) {
    return choice;
  }
  const GraphHistory::Version* added =
      former_.With(*choice.version, {.guid = message.writer,
                                     .name = std::string(message.topic),
                                     .type = std::string(message.type),
                                     .node = std::string(message.sender)});
  if (added == nullptr) return choice;
  choice.version = added;
  return choice;
}

std::optional<Piece> InspectionLine::Next(const SensorHost& host) {
  Entry& first = batches_.front();
  const bool primary = host.name == context_.config.primary_sensor;  // no other has a graph
  if (!std::exchange(first.has_graph, true) && primary) {
    const Batch& batch = *first.waiting.batch;
    former_.Apply(batch.incarnation, batch.graph, state_.graph.get());
  }
  const size_t from = first.waiting.judged;
  const size_t to = Ask(first, host);
  ready_ = to > from;
  if (!ready_) return std::nullopt;
  first.waiting.judged = to;
  return Piece{.waiting = first.waiting, .from = from, .to = to, .verdicts = first.verdicts};
}

size_t InspectionLine::Ask(Entry& entry, const SensorHost& host) {
  const std::shared_ptr<const engine::CompiledPolicy>& program = state_.program();
  const Batch& batch = *entry.waiting.batch;
  const std::vector<Observation>& observations = batch.observations;
  const bool inspects =
      !program->rules().inspections.empty() && host.name == context_.config.primary_sensor;
  if (entry.program != program) {
    // New, or asked under rules that are no longer in force.
    entry.program = program;
    entry.ticket = ++last_ticket_;
    entry.verdicts.assign(inspects ? observations.size() : 0, {});
    entry.asked = entry.waiting.judged;
    entry.unanswered = 0;
  }
  while (entry.asked < observations.size() && entry.unanswered < kAskedMax) {
    const auto* message = std::get_if<MessageSeen>(&observations[entry.asked].what);
    if (message != nullptr && !KnowsGraph(entry, host, *message)) break;
    const size_t index = entry.asked++;
    if (!inspects || message == nullptr || !context_.watch.Concerns(message->topic)) continue;
    engine::Event event;
    event.what = EventOf(*message, Choose(host, batch, *message));
    std::vector<uint32_t> needed = engine::NeededInspections(event, context_.now(), state_);
    if (!needed.empty()) AskOne(entry, host, index, std::move(needed));
  }
  return entry.unanswered == 0 ? entry.asked : entry.waiting.judged;
}

void InspectionLine::AskOne(Entry& entry, const SensorHost& host, size_t index,
                            std::vector<uint32_t> needed) {
  const Observation& seen = entry.waiting.batch->observations[index];
  const auto& message = std::get<MessageSeen>(seen.what);
  entry.verdicts[index].assign(entry.program->rules().inspections.size(),
                               engine::Verdict::kUnscanned);
  if (context_.policy.inspector == nullptr) return losses_.OnSkipped(message, needed.size());
  ++entry.unanswered;
  const engine::MessageEvent event = EventOf(message, Choose(host, *entry.waiting.batch, message));
  context_.Do(action::Inspect{
      .inspector = context_.policy.inspector,
      .ticket = entry.ticket,
      .index = index,
      .inspections = std::move(needed),
      .message = {
          .topic = event.topic,
          .type = event.type,
          .sender = event.sender,
          .writer = event.writer,
          .time_unix_ns = seen.boottime_ns + (host.session ? host.session->unix_offset_ns : 0),
          .payload = absl::string_view(message.payload)
                         .substr(0, context_.watch.PayloadBytes(message.topic)),
          .size_bytes = message.size_bytes,
          .owner = entry.waiting.batch}});
}

void InspectionLine::OnInspected(const input::Inspected& in) {
  if (batches_.empty() || batches_.front().ticket != in.ticket) return;
  Entry& first = batches_.front();
  for (size_t i = 0; i < in.asked.size() && i < in.verdicts.size(); ++i) {
    first.verdicts[in.index][in.asked[i]] = in.verdicts[i];
  }
  const auto skipped = static_cast<uint64_t>(
      std::count(in.verdicts.begin(), in.verdicts.end(), engine::Verdict::kUnscanned));
  losses_.OnSkipped(std::get<MessageSeen>(first.waiting.batch->observations[in.index].what),
                    skipped);
  --first.unanswered;
  ready_ = true;
}

bool InspectionLine::KnowsGraph(const Entry& entry, const SensorHost& host,
                                const MessageSeen& message) {
  if (host.name != context_.config.primary_sensor) return true;
  if (!Choose(host, *entry.waiting.batch, message).wait) return true;
  if (context_.now_ns() - entry.arrived_ns < context_.timing.graph_wait_ns) return false;
  history_.GiveUp(message.writer);
  context_.Count(Counter::kMessagesUnattributed);
  return true;
}

}  // namespace rips::pipeline
