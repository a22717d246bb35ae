// What must be on disk before what may leave: records that are collected, and one batch of them at
// a time with the recorder.
//
//   collect      Add...: decisions, refusals, stages, alerts, receipts; Touch: what a checkpoint
//                will say
//   in flight    Seal: all that was collected, with a checkpoint; what comes now waits
//   recorded     OnRecorded(true): what was waiting for it may go on (Settled)
//   not recorded OnRecorded(false): all of it stands before what was collected since; its lowerings
//                are never commanded
//   abandoned    Abandon: the robot has another owner; nothing is recorded any more
//
// One batch at a time: a batch that succeeds after one that failed would record sequence numbers of
// observations whose effects are not durable (I2). Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_DURABLE_OUTBOX_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_DURABLE_OUTBOX_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "policy_server/policy/levels/level_machine.h"
#include "policy_server/policy/levels/level_table.h"
#include "policy_server/server/store/records.h"
#include "services/base/decision_id.h"

namespace rips::pipeline {

// Not thread-safe.
class DurableOutbox {
 public:
  // Alerts that wait; the oldest go first.
  static constexpr size_t kAlertsMax = 1'000;
  // Receipts that wait; the oldest go first.
  static constexpr size_t kReceiptsMax = 64;

  // What the store does not know yet, besides records.
  struct Unsaved {
    bool sequences = false;
    bool variables = false;
    bool bundle = true;
    bool maintenance = false;
  };
  // Of a batch that the recorder has answered for.
  struct Settled {
    store::HighWater judged;
    std::vector<store::DecisionRecord> decisions;
    // In the order in which they were decided.
    std::vector<levels::Transition> lowerings;
    // Alerts dropped since the last batch that was recorded.
    uint64_t alerts_dropped = 0;
  };

  // Of the batches.
  DurableOutbox(std::string robot, uint64_t tenure)
      : collected_{.robot = std::move(robot), .tenure = tenure} {}
  void Abandon() { collected_.tenure = 0; }

  void AddDecision(store::DecisionRecord decision);
  void AddRefusal(store::RefusalRecord refusal);
  void AddStage(store::StageUpdate stage);
  // False: the oldest alert was dropped for it.
  bool AddAlert(store::AlertRecord alert);
  // Of one command only the newest waits.
  void AddReceipt(store::ReceiptRecord receipt);
  // A transition that must not be commanded before its decision is durable.
  void AddLowering(const levels::Transition& lowering);
  void Touch(bool Unsaved::*what) { unsaved_.*what = true; }

  // The newest lowering that is neither commanded nor taken back; none = commands may leave.
  const DecisionId& held_back() const { return held_back_; }
  // It was commanded, or taken back.
  void Release(const DecisionId& lowering);

  const Unsaved& unsaved() const { return unsaved_; }
  // That the store is not known to have, oldest first: those in flight, and those that wait.
  std::vector<store::AlertRecord> alerts() const;
  // There is something to record, and nothing in flight.
  bool CanSeal() const;
  // Records wait, and the last batch was recorded.
  bool due() const { return !collected_.empty() && !failing_; }
  // All of it is recorded, or will never be.
  bool done() const;
  // CanSeal. Hands out all that was collected; `checkpoint` is of now.
  std::shared_ptr<const store::WriteBatch> Seal(store::Checkpoint checkpoint);
  // Of the batch in flight.
  Settled OnRecorded(bool ok);
  // Of what was collected, the decisions that the store's reserve is for: a lowering that is not
  // commanded must not be what a restart finds, nor a raise after it to less than what was held
  // before.
  store::WriteBatch Raises(const levels::LevelTable& levels) const;

 private:
  struct InFlight {
    std::shared_ptr<const store::WriteBatch> batch;
    std::vector<levels::Transition> lowerings;
  };

  store::WriteBatch collected_;
  std::vector<levels::Transition> lowerings_;
  Unsaved unsaved_;
  std::optional<InFlight> in_flight_;
  DecisionId held_back_;
  bool failing_ = false;
  uint64_t alerts_dropped_ = 0;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_DURABLE_OUTBOX_H_
