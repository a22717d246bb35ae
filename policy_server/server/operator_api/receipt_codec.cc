#include "policy_server/server/operator_api/receipt_codec.h"

#include <set>
#include <utility>

#include "policy_server/server/operator_api/answer_limits.h"
#include "services/model_proto/actuator_codec.h"

namespace rips::operator_api {

void Encode(const pipeline::LoggedReceipt& receipt, rips::v1::ReceivedReceipt* out) {
  out->set_unix_ns(receipt.unix_ns);
  out->set_host(receipt.host);
  out->set_command(receipt.command);
  *out->mutable_receipt() = model_proto::Encode(receipt.receipt);
}

void Encode(const std::vector<store::ReceiptRecord>& newest,
            const std::vector<store::ReceiptRecord>& stored, uint32_t limit,
            rips::v1::ListReceiptsResponse& out) {
  // After the server was started anew an actuator repeats what it said last, of a command that this
  // process did not send.
  std::set<std::pair<std::string, std::string>> known;
  for (const store::ReceiptRecord& receipt : stored) {
    known.emplace(receipt.host, receipt.receipt.command_id);
  }
  AnswerRoom room;
  const size_t most = limit == 0 ? kReceiptsListed : limit;
  std::set<std::pair<std::string, std::string>> told;
  for (const auto* receipts : {&newest, &stored}) {
    for (const store::ReceiptRecord& receipt : *receipts) {
      if (static_cast<size_t>(out.receipts_size()) == most) return;
      const std::pair key(receipt.host, receipt.receipt.command_id);
      const bool repeated = receipts == &newest && receipt.command == pipeline::kUnknownCommand &&
                            known.contains(key);
      if (repeated || !told.insert(key).second) continue;
      rips::v1::ReceivedReceipt row;
      Encode(receipt, &row);
      if (!room.Take(row)) return;
      *out.add_receipts() = std::move(row);
    }
  }
}

void Encode(const pipeline::DrillEntry& drill, rips::v1::ActuatorDrill* out) {
  out->set_level(drill.level);
  out->set_host(drill.host);
  if (drill.stage) out->set_stage(model_proto::Encode(*drill.stage));
  model_proto::Encode(drill.steps, *out->mutable_steps());
  out->set_detail(drill.detail);
}

}  // namespace rips::operator_api
