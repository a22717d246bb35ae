// The message lane: batches wait here, in order, until their messages have been inspected. The
// control lane never does.
#include <utility>

#include "policy_server/pipeline/robot.h"

namespace rips::pipeline {
namespace {

// Answers that one robot waits for at a time; inspectors keep a short line for each robot.
constexpr size_t kAskedMax = 32;

}  // namespace

void Robot::AdvanceMessages() {
  // An answer may come while a question is being asked.
  if (advancing_) return;
  advancing_ = true;
  while (!message_line_.empty()) {
    Inspecting& first = message_line_.front();
    if (LiveSensor(first.host, first.link.get()) != nullptr) {
      if (!AskInspections(first)) break;
      JudgeBatch(first.host, first.link.get(), *first.batch, first.verdicts);
    }
    // Of a stream that has ended: it was not acknowledged and will be sent again.
    message_line_.pop_front();
  }
  advancing_ = false;
}

// True when every message of the batch was told all that the rules in force may ask.
bool Robot::AskInspections(Inspecting& batch) {
  const std::shared_ptr<const engine::Program>& program = state_.program();
  if (batch.program != program) {
    // New, or asked under rules that are no longer in force.
    batch.program = program;
    batch.ticket = ++last_ticket_;
    batch.verdicts.assign(batch.batch->observations.size(), {});
    batch.asked = 0;
    batch.waiting = 0;
  }
  if (program->rules().inspections.empty() || batch.host != config_.primary_sensor) return true;
  const Instant now = ports_.clock->Now();
  const std::vector<Observation>& observations = batch.batch->observations;
  while (batch.asked < observations.size() && batch.waiting < kAskedMax) {
    const size_t index = batch.asked++;
    const auto* message = std::get_if<MessageSeen>(&observations[index].what);
    if (message == nullptr) continue;
    engine::Event event;
    event.what = ToEvent(*message);
    std::vector<uint32_t> needed = engine::NeededInspections(event, now, state_);
    if (!needed.empty()) AskInspection(batch, index, std::move(needed));
  }
  return batch.asked == observations.size() && batch.waiting == 0;
}

void Robot::AskInspection(Inspecting& batch, size_t index, std::vector<uint32_t> needed) {
  const Observation& seen = batch.batch->observations[index];
  const auto& message = std::get<MessageSeen>(seen.what);
  batch.verdicts[index].assign(batch.program->rules().inspections.size(),
                               engine::Verdict::kUnscanned);
  if (policy_.inspector == nullptr) return;
  ++batch.waiting;
  const engine::MessageEvent event = ToEvent(message);
  const SensorHost& host = sensors_[batch.host];
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
                             [this, post = ports_.post, ticket = batch.ticket, index,
                              needed](std::vector<engine::Verdict> verdicts) {
                               post([this, ticket, index, needed, verdicts = std::move(verdicts)] {
                                 OnInspected(ticket, index, needed, verdicts);
                               });
                             });
}

void Robot::OnInspected(uint64_t ticket, size_t index, const std::vector<uint32_t>& asked,
                        const std::vector<engine::Verdict>& verdicts) {
  if (message_line_.empty() || message_line_.front().ticket != ticket) return;
  Inspecting& batch = message_line_.front();
  for (size_t i = 0; i < asked.size() && i < verdicts.size(); ++i) {
    batch.verdicts[index][asked[i]] = verdicts[i];
  }
  --batch.waiting;
  AdvanceMessages();
}

}  // namespace rips::pipeline
