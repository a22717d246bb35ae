#include "policy_server/server/pooled_inspector.h"

#include "absl/strings/escaping.h"

namespace rips::server {

void PooledInspector::Inspect(const std::string& robot, const std::vector<uint32_t>& inspections,
                              const pipeline::InspectedMessage& message,
                              std::function<void(std::vector<engine::Verdict>)> done) {
  const std::vector<engine::Verdict> unscanned(inspections.size(), engine::Verdict::kUnscanned);
  inspect::InspectionRequest request{
      .set = set_,
      .indices = inspections,
      .message = {.robot = robot,
                  .topic = std::string(message.topic),
                  .type = std::string(message.type),
                  .sender = std::string(message.sender),
                  .writer_hex = absl::BytesToHexString(message.writer.ToBytes()),
                  .time_unix_ns = message.time_unix_ns,
                  .payload = message.payload,
                  .owner = message.owner,
                  .size_bytes = message.size_bytes,
                  .available = !message.payload.empty()}};
  const inspect::Skipped skipped = pool_->Submit(
      std::move(request), [done](std::vector<engine::Verdict> verdicts,
                                 const inspect::InspectionStats&) { done(std::move(verdicts)); });
  if (skipped != inspect::Skipped::kNot) done(unscanned);
}

}  // namespace rips::server
