// Robot: what is recorded, and what happens when it is durable or cannot be.
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/robot.h"

namespace rips::pipeline {

store::Checkpoint Robot::MakeCheckpoint() const {
  store::Checkpoint checkpoint{.robot = config_.id,
                               .soft_suspended = state_.level.soft_suspended(),
                               .rules_halted = state_.halted(),
                               .resumed_at = state_.level.resumed_at()};
  if (outbox_.unsaved().variables) checkpoint.variables = state_.Variables();
  if (outbox_.unsaved().bundle) checkpoint.bundle = policy_.bundle_id;
  for (const auto& [host, sensor] : sensors_) {
    for (const auto& [key, sequence] : sensor.sequences.all()) {
      const auto lane = key.second == Lane::kControl ? store::LaneKey::Lane::kControl
                                                     : store::LaneKey::Lane::kMessages;
      checkpoint.high_water[{
          .host = host, .incarnation = absl::BytesToHexString(key.first), .lane = lane}] = sequence;
    }
  }
  return checkpoint;
}

void Robot::Flush() {
  if (!outbox_.CanSeal()) return;
  const std::shared_ptr<const store::WriteBatch> batch = outbox_.Seal(MakeCheckpoint());
  next_.checkpoint_ns = ports_.clock->Now().boottime_ns + timing_.checkpoint_ns;
  // On another thread this robot may be gone by then; what is posted is dropped if it is.
  ports_.recorder->Record(*batch, [this, batch, audience = ports_.audience,
                                   post = ports_.post](const absl::Status& status) {
    if (status.ok()) {
      for (const store::AlertRecord& alert : batch->alerts) audience->OnAlert(alert);
    }
    post([this, status] { OnRecorded(status); });
  });
}

void Robot::OnRecorded(const absl::Status& status) {
  const DurableOutbox::Settled settled = outbox_.OnRecorded(status.ok());
  if (!status.ok()) {
    if (absl::IsResourceExhausted(status)) SaveRaises();
    for (const levels::Transition& lowering : settled.lowerings) {
      TakeBack(lowering, engine::Severity::kCritical,
               absl::StrCat("it could not be recorded: ", status.message()));
    }
    return PublishStatus();
  }
  if (settled.alerts_dropped > 0) {
    OwnAlert(engine::Severity::kHigh, absl::StrCat(settled.alerts_dropped, " alerts were dropped ",
                                                   "while the store could not be written"));
  }
  Acknowledge(settled.judged);
  for (const levels::Transition& lowering : settled.lowerings) OrderRecorded(lowering);
  for (const store::DecisionRecord& decision : settled.decisions)
    orders_.OnDurable(decision.decision_id);
  PublishStatus();
  Flush();
}

void Robot::Acknowledge(const store::HighWater& judged) {
  const store::StorePoint point = ports_.recorder->point();
  for (const auto& [key, sequence] : judged) {
    const auto it = sensors_.find(key.host);
    if (it == sensors_.end()) continue;
    const Lane lane = key.lane == store::LaneKey::Lane::kControl ? Lane::kControl : Lane::kMessages;
    const std::string incarnation = absl::HexStringToBytes(key.incarnation);
    it->second.durable.Load(incarnation, lane, sequence);
    if (it->second.session) {
      it->second.session->link->Acknowledge(incarnation, lane, sequence, point.commit);
    }
  }
  for (auto& [name, host] : sensors_) host.durable.KeepOnly(host.sequences);
}

void Robot::OrderRecorded(const levels::Transition& lowering) {
  outbox_.Release(lowering.decision_id);
  // A raise may have been decided meanwhile: then that one has been commanded already.
  if (lowering.decision_id != state_.level.decision_id()) return;
  if (lowering.cause.kind == levels::Cause::Kind::kRule && lowering.lowers()) {
    // What a rule saw must hold until its lowering leaves.
    UpdateEvidence(ports_.clock->Now());
    if (const std::string broken = evidence_.BrokenSince(lowering.at); !broken.empty()) {
      return TakeBack(lowering, engine::Severity::kMedium,
                      absl::StrCat("while it was recorded, ", broken));
    }
  }
  Order(lowering);
}

// Written again with the rest when that can be written, which changes nothing.
void Robot::SaveRaises() {
  std::vector<store::DecisionRecord> raises = outbox_.Raises(levels());
  if (raises.empty()) return;
  ports_.recorder->Record({.decisions = raises, .uses_reserve = true},
                          [this, raises, post = ports_.post](const absl::Status& status) {
                            if (!status.ok()) return;
                            post([this, raises] {
                              for (const auto& raise : raises) orders_.OnDurable(raise.decision_id);
                            });
                          });
}

void Robot::TakeBack(const levels::Transition& lowering, engine::Severity severity,
                     std::string why) {
  const std::string text = absl::StrCat("a lowering was taken back: ", std::move(why));
  orders_.Refuse(lowering.decision_id, absl::FailedPreconditionError(text));
  outbox_.Release(lowering.decision_id);
  if (state_.level.level() >= lowering.from) return;
  OwnAlert(severity, text);
  Adopt(lowering.from, state_.level.decision_id(), text);
}

}  // namespace rips::pipeline
