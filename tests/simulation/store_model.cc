#include "tests/simulation/store_model.h"

#include <algorithm>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "tests/simulation/level_names.h"

namespace rips::simulation {
namespace {

bool Lowers(const store::DecisionRecord& decision) {
  return LevelIndex(decision.to) < LevelIndex(decision.from);
}

std::string Summary(const store::WriteBatch& batch) {
  std::string text;
  for (const store::DecisionRecord& each : batch.decisions) {
    absl::StrAppend(&text, " decision ", ToString(each.decision_id), " ", each.from, " to ",
                    each.to, " (", each.cause, ")");
  }
  if (!batch.alerts.empty()) absl::StrAppend(&text, " ", batch.alerts.size(), " alerts");
  for (const auto& [lane, sequence] : batch.checkpoint.high_water) {
    absl::StrAppend(&text, lane.lane == store::LaneKey::Lane::kControl ? " c" : " m", sequence);
  }
  return text;
}

}  // namespace

void StoreModel::Open() {
  const uint64_t commit = generations_.empty() ? 0 : generations_.back().last_commit;
  generations_.push_back(
      {.id = absl::StrFormat("%016d", generations_.size() + 1), .last_commit = commit});
}

void StoreModel::Crash() {
  if (context_.scheduler.Chance(50) && disk_ == Disk::kWorks) {
    const auto torn = context_.scheduler.Between(0, static_cast<int64_t>(waiting_.size()));
    for (int64_t i = 0; i < torn; ++i) {
      (void)Apply(waiting_[static_cast<size_t>(i)].batch);
    }
  }
  ++life_;
  waiting_.clear();
  writing_ = false;
  healthy_ = true;
}

store::Acquired StoreModel::Acquire() {
  tenure_ = DrawTerm(0);
  store::RobotRecord record = record_;
  for (const auto& [decision_id, each] : decisions_) {
    if (decision_id <= record.resumed_at || !absl::StartsWith(each.cause, "rule ")) continue;
    record.rule_decisions.push_back({decision_id, each.from, each.to, each.time_unix_ns});
  }
  return {.record = std::move(record), .tenure = tenure_};
}

absl::Status StoreModel::CheckTenure(uint64_t tenure) const {
  return tenure == tenure_ ? absl::OkStatus() : store::Fenced("r1", tenure, tenure_);
}

uint64_t StoreModel::DrawTerm(uint64_t above) {
  record_.highest_term = std::max(record_.highest_term, above) + 1;
  context_.checker.OnTermDrawn(record_.highest_term);
  return record_.highest_term;
}

void StoreModel::Later(int64_t delay_ns, std::function<void()> task) {
  context_.scheduler.After(delay_ns, [this, life = life_, task = std::move(task)] {
    if (life == life_) task();
  });
}

bool StoreModel::CalledEarly(const store::WriteBatch& batch) const {
  const bool lowers = std::any_of(batch.decisions.begin(), batch.decisions.end(), Lowers);
  if (context_.fault == Fault::kEarlyLowering) return lowers;
  return context_.fault == Fault::kEarlyAcknowledgement && batch.decisions.empty() &&
         batch.alerts.empty();
}

void StoreModel::Record(store::WriteBatch batch, std::function<void(const absl::Status&)> done) {
  context_.checker.OnRecord(batch, context_.scheduler.now_ns());
  if (CalledEarly(batch)) std::exchange(done, nullptr)(absl::OkStatus());
  waiting_.push_back({std::move(batch), std::move(done)});
  ScheduleWrite();
}

void StoreModel::ScheduleWrite() {
  if (writing_ || waiting_.empty()) return;
  writing_ = true;
  const int64_t hang_ns = std::exchange(hang_ns_, 0);
  const bool slow = context_.scheduler.Chance(10);
  Later(hang_ns + context_.scheduler.Between(1, slow ? 800 : 60) * kMs,
        [this, count = waiting_.size()] { Write(count); });
}

void StoreModel::Write(size_t count) {
  for (size_t i = 0; i < count; ++i) {
    const Waiting next = std::move(waiting_.front());
    waiting_.pop_front();
    absl::Status status;
    if (disk_ == Disk::kFails) status = absl::UnavailableError("disk error");
    if (disk_ == Disk::kFull && !next.batch.uses_reserve) {
      status = absl::ResourceExhaustedError("disk full");
    }
    if (status.ok()) status = Apply(next.batch);
    if (!next.batch.uses_reserve) healthy_ = status.ok();
    if (!status.ok()) context_.trace.Add("store", status.message());
    if (next.done) next.done(status);
  }
  writing_ = false;
  ScheduleWrite();
}

absl::Status StoreModel::Apply(const store::WriteBatch& batch) {
  if (absl::Status valid = store::Validate(batch); !valid.ok()) return valid;
  if (absl::Status owned = CheckTenure(batch.tenure); !owned.ok()) return owned;
  for (const store::DecisionRecord& decision : batch.decisions) {
    const auto known = decisions_.find(decision.decision_id);
    if (known != decisions_.end() && known->second != decision) {
      return absl::AlreadyExistsError("the decision names another decision");
    }
  }
  for (const store::DecisionRecord& decision : batch.decisions) {
    decisions_[decision.decision_id] = decision;
    record_.highest_term = std::max(record_.highest_term, decision.decision_id.term);
    if (decision.decision_id <= record_.decision_id) continue;
    record_.decision_id = decision.decision_id;
    record_.level = decision.to;
  }
  const store::Checkpoint& checkpoint = batch.checkpoint;
  if (checkpoint.variables) record_.variables = *checkpoint.variables;
  if (checkpoint.soft_suspended) record_.soft_suspended = *checkpoint.soft_suspended;
  if (checkpoint.rules_halted) record_.rules_halted = *checkpoint.rules_halted;
  if (checkpoint.resumed_at) record_.resumed_at = *checkpoint.resumed_at;
  if (checkpoint.maintenance) record_.maintenance = *checkpoint.maintenance;
  for (const auto& [lane, sequence] : checkpoint.high_water) {
    uint64_t& stored = record_.high_water[lane];
    stored = std::max(stored, sequence);
  }
  ++generations_.back().last_commit;
  context_.trace.Add("store", absl::StrCat("durable:", Summary(batch)));
  context_.checker.OnDurable(batch, record_);
  return absl::OkStatus();
}

void StoreModel::FindDecision(const std::string&, const DecisionId& decision_id,
                              std::function<void(const pipeline::FoundDecision&)> done) {
  Later(context_.scheduler.Between(0, 20) * kMs, [this, decision_id, done = std::move(done)] {
    const auto found = decisions_.find(decision_id);
    if (found == decisions_.end()) return done(std::nullopt);
    done(found->second.to);
  });
}

void StoreModel::NextTerm(const std::string&, uint64_t tenure, uint64_t above,
                          std::function<void(const absl::StatusOr<uint64_t>&)> done) {
  Later(context_.scheduler.Between(0, 20) * kMs, [this, tenure, above, done = std::move(done)] {
    if (absl::Status owned = CheckTenure(tenure); !owned.ok()) return done(owned);
    if (disk_ != Disk::kWorks) return done(absl::UnavailableError("disk error"));
    done(DrawTerm(above));
  });
}

store::StorePoint StoreModel::point() const {
  return {.generation = generations_.back().id, .commit = generations_.back().last_commit};
}

bool StoreModel::GoesOnFrom(const store::StorePoint& seen) const {
  return store::GoesOnFrom(generations_, point().commit, seen);
}

}  // namespace rips::simulation
