#include "policy_server/server/robot/context/durable_outbox.h"

#include <algorithm>
#include <utility>

#include "services/base/check.h"

namespace rips::pipeline {
namespace {

template <typename T>
void Prepend(const std::vector<T>& front, std::vector<T>& to) {
  to.insert(to.begin(), front.begin(), front.end());
}

}  // namespace

void DurableOutbox::AddDecision(store::DecisionRecord decision) {
  collected_.decisions.push_back(std::move(decision));
}

void DurableOutbox::AddRefusal(store::RefusalRecord refusal) {
  collected_.refusals.push_back(std::move(refusal));
}

void DurableOutbox::AddStage(store::StageUpdate stage) {
  collected_.stages.push_back(std::move(stage));
}

bool DurableOutbox::AddAlert(store::AlertRecord alert) {
  const bool full = collected_.alerts.size() >= kAlertsMax;
  if (full) {
    collected_.alerts.erase(collected_.alerts.begin());
    ++alerts_dropped_;
  }
  collected_.alerts.push_back(std::move(alert));
  return !full;
}

void DurableOutbox::AddReceipt(store::ReceiptRecord receipt) {
  std::vector<store::ReceiptRecord>& receipts = collected_.receipts;
  std::erase_if(receipts, [&](const store::ReceiptRecord& each) {
    return each.host == receipt.host && each.receipt.command_id == receipt.receipt.command_id;
  });
  receipts.push_back(std::move(receipt));
  if (receipts.size() > kReceiptsMax) receipts.erase(receipts.begin());
}

void DurableOutbox::AddLowering(const levels::Transition& lowering) {
  lowerings_.push_back(lowering);
  held_back_ = lowering.decision_id;
}

void DurableOutbox::Release(const DecisionId& lowering) {
  if (held_back_ == lowering) held_back_ = DecisionId{};
}

std::vector<store::AlertRecord> DurableOutbox::alerts() const {
  std::vector<store::AlertRecord> alerts = collected_.alerts;
  if (in_flight_) Prepend(in_flight_->batch->alerts, alerts);
  return alerts;
}

bool DurableOutbox::CanSeal() const {
  return !in_flight_ && collected_.tenure != 0 &&
         (!collected_.empty() || unsaved_.sequences || unsaved_.variables || unsaved_.bundle ||
          unsaved_.maintenance);
}

bool DurableOutbox::done() const {
  if (in_flight_) return false;
  return collected_.tenure == 0 || (collected_.empty() && !unsaved_.sequences &&
                                    !unsaved_.variables && !unsaved_.maintenance);
}

std::shared_ptr<const store::WriteBatch> DurableOutbox::Seal(store::Checkpoint checkpoint) {
  RIPS_CHECK(!in_flight_, "a batch is in flight already");
  store::WriteBatch batch =
      std::exchange(collected_, {.robot = collected_.robot, .tenure = collected_.tenure});
  batch.checkpoint = std::move(checkpoint);
  unsaved_ = {.bundle = false};
  in_flight_ = InFlight{.batch = std::make_shared<const store::WriteBatch>(std::move(batch)),
                        .lowerings = std::exchange(lowerings_, {})};
  return in_flight_->batch;
}

DurableOutbox::Settled DurableOutbox::OnRecorded(bool ok) {
  RIPS_CHECK(in_flight_, "no batch is in flight");
  InFlight done = *std::exchange(in_flight_, std::nullopt);
  failing_ = !ok;
  Settled settled{.judged = done.batch->checkpoint.high_water,
                  .decisions = done.batch->decisions,
                  .lowerings = std::move(done.lowerings)};
  if (ok) {
    settled.alerts_dropped = std::exchange(alerts_dropped_, 0);
    return settled;
  }
  Prepend(done.batch->decisions, collected_.decisions);
  Prepend(done.batch->refusals, collected_.refusals);
  Prepend(done.batch->stages, collected_.stages);
  Prepend(done.batch->alerts, collected_.alerts);
  std::vector<store::ReceiptRecord> newer =
      std::exchange(collected_.receipts, done.batch->receipts);
  for (store::ReceiptRecord& receipt : newer) AddReceipt(std::move(receipt));
  unsaved_ = {.sequences = true, .variables = true, .bundle = true, .maintenance = true};
  return settled;
}

store::WriteBatch DurableOutbox::Raises(const levels::LevelTable& levels) const {
  store::WriteBatch raises{
      .robot = collected_.robot, .tenure = collected_.tenure, .uses_reserve = true};
  levels::LevelIndex held = 0;
  for (const store::DecisionRecord& decision : collected_.decisions) {
    const auto from = levels.Find(decision.from);
    const auto to = levels.Find(decision.to);
    if (from && to && *to < *from) held = std::max(held, *from);
    if (!to || *to >= held) raises.decisions.push_back(decision);
  }
  return raises;
}

}  // namespace rips::pipeline
