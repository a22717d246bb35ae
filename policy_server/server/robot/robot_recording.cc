// Robot: what is recorded, and what happens when it is durable or cannot be.
#include <algorithm>
#include <iterator>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/robot.h"

namespace rips::pipeline {
namespace {

constexpr size_t kAnswersKept = 64;

template <typename T>
void Prepend(std::vector<T>& front, std::vector<T>& back) {
  std::move(back.begin(), back.end(), std::back_inserter(front));
  back = std::move(front);
}

}  // namespace

// One batch at a time: a batch that succeeds after one that failed would record sequence numbers of
// observations whose effects are not durable.
void Robot::Flush() {
  if (recording_ > 0) return;
  if (pending_.empty() && !unsaved_.sequences && !unsaved_.variables && !unsaved_.bundle) return;
  store::Checkpoint checkpoint{.robot = config_.id,
                               .soft_suspended = state_.level.soft_suspended(),
                               .rules_halted = state_.halted(),
                               .resumed_at = state_.level.resumed_at()};
  if (unsaved_.variables) checkpoint.variables = state_.Variables();
  if (unsaved_.bundle) checkpoint.bundle = policy_.bundle_id;
  for (const auto& [host, sensor] : sensors_) {
    for (const auto& [key, sequence] : sensor.sequences.all()) {
      const auto lane = key.second == Lane::kControl ? store::LaneKey::Lane::kControl
                                                     : store::LaneKey::Lane::kMessages;
      checkpoint.high_water[{
          .host = host, .incarnation = absl::BytesToHexString(key.first), .lane = lane}] = sequence;
    }
  }
  store::HighWater judged = checkpoint.high_water;
  store::WriteBatch batch = std::exchange(pending_, {});
  batch.checkpoints.push_back(std::move(checkpoint));
  unsaved_.sequences = unsaved_.variables = unsaved_.bundle = false;
  next_.checkpoint_ns = ports_.clock->Now().boottime_ns + timing_.checkpoint_ns;

  auto lowerings = std::exchange(pending_lowerings_, {});
  auto kept = std::make_shared<store::WriteBatch>(batch);
  ++recording_;
  // On another thread this robot may be gone by then; what is posted is dropped if it is.
  ports_.recorder->Record(std::move(batch), [this, audience = ports_.audience, post = ports_.post,
                                             kept, judged, lowerings](const absl::Status& status) {
    if (status.ok()) {
      for (const store::AlertRecord& alert : kept->alerts) audience->OnAlert(alert);
    }
    post([this, kept, judged, lowerings, status] {
      --recording_;
      if (!status.ok()) {
        // Nothing is forgotten: what was not written goes in front of what
        // comes next.
        kept->checkpoints.clear();
        Prepend(kept->decisions, pending_.decisions);
        Prepend(kept->refusals, pending_.refusals);
        Prepend(kept->stages, pending_.stages);
        Prepend(kept->alerts, pending_.alerts);
        unsaved_.sequences = unsaved_.variables = unsaved_.bundle = true;
      }
      OnRecorded(status, *kept, judged, lowerings);
      if (status.ok()) Flush();
    });
  });
}

void Robot::OnRecorded(const absl::Status& status, const store::WriteBatch& recorded,
                       const store::HighWater& judged,
                       const std::vector<levels::Transition>& lowerings) {
  store_failing_ = !status.ok();
  if (!status.ok()) {
    if (absl::IsResourceExhausted(status)) SaveRaises();
    for (const levels::Transition& lowering : lowerings) {
      TakeBack(lowering, engine::Severity::kCritical,
               absl::StrCat("it could not be recorded: ", status.message()));
    }
    PublishStatus();
    return;
  }
  if (const uint64_t dropped = std::exchange(alerts_dropped_, 0); dropped > 0) {
    OwnAlert(engine::Severity::kHigh,
             absl::StrCat(dropped, " alerts were dropped while the store could not be written"));
  }
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
  for (const levels::Transition& lowering : lowerings) OrderRecorded(lowering);
  AnswerOrders(recorded.decisions);
  PublishStatus();
}

void Robot::OrderRecorded(const levels::Transition& lowering) {
  if (lowering.mark == awaiting_durable_) awaiting_durable_ = Mark{};
  // A raise may have been decided meanwhile: then that one has been commanded already.
  if (lowering.mark != state_.level.mark()) return;
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

void Robot::AnswerOrders(const std::vector<store::DecisionRecord>& durable) {
  for (const store::DecisionRecord& decision : durable) {
    const auto it = orders_.waiting.find(decision.mark);
    if (it == orders_.waiting.end()) continue;
    const WaitingOrder waiting = std::move(it->second);
    orders_.waiting.erase(it);
    orders_.answered.emplace_back(waiting.request_id, waiting.answer);
    if (orders_.answered.size() > kAnswersKept) orders_.answered.pop_front();
    waiting.reply(waiting.answer);
  }
}

void Robot::SaveRaises() {
  store::WriteBatch raises{.uses_reserve = true};
  // A lowering that is not commanded must not be what a restart finds, nor a raise after it to less
  // than what was held before.
  levels::LevelIndex held = 0;
  for (const store::DecisionRecord& decision : pending_.decisions) {
    const auto from = levels().Find(decision.from);
    const auto to = levels().Find(decision.to);
    if (from && to && *to < *from) held = std::max(held, *from);
    if (!to || *to >= held) raises.decisions.push_back(decision);
  }
  // Written again with the rest when that can be written, which changes nothing.
  if (raises.decisions.empty()) return;
  std::vector<store::DecisionRecord> saved = raises.decisions;
  ports_.recorder->Record(std::move(raises), [this, post = ports_.post, saved = std::move(saved)](
                                                 const absl::Status& status) {
    if (!status.ok()) return;
    post([this, saved] { AnswerOrders(saved); });
  });
}

void Robot::TakeBack(const levels::Transition& lowering, engine::Severity severity,
                     std::string why) {
  const std::string text = absl::StrCat("a lowering was taken back: ", std::move(why));
  if (const auto it = orders_.waiting.find(lowering.mark); it != orders_.waiting.end()) {
    LevelAnswer answer = it->second.answer;
    answer.status = absl::FailedPreconditionError(text);
    it->second.reply(answer);
    orders_.waiting.erase(it);
  }
  if (lowering.mark == awaiting_durable_) awaiting_durable_ = Mark{};
  if (state_.level.level() >= lowering.from) return;
  OwnAlert(severity, text);
  Adopt(lowering.from, state_.level.mark(), text);
}

}  // namespace rips::pipeline
