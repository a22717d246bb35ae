#include "tests/simulation/invariants.h"

#include <algorithm>
#include <iterator>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace rips::simulation {

using actuator::ExecutorReport;

void Checker::Fail(absl::string_view invariant, absl::string_view what, absl::string_view detail) {
  if (violation_.has_value()) return;
  violation_ = {std::string(invariant),
                detail.empty() ? std::string(what) : absl::StrCat(what, ": ", detail)};
}

bool Checker::LoweredBetween(const DecisionId& from, const DecisionId& to) const {
  for (auto it = decisions_.upper_bound(from); it != decisions_.end() && it->first <= to; ++it) {
    if (it->second.lowers && it->second.durable) return true;
  }
  return false;
}

// --- the server and its store

void Checker::OnServerStart(int64_t now_ns) {
  judged_ = judged_durably_;
  began_ns_.push_back(server_began_ns_ = now_ns);
}

void Checker::CheckLowering(const Decision& lowering) {
  const store::DecisionRecord& decision = lowering.record;
  const int from = LevelIndex(decision.from);
  if (absl::StartsWith(decision.cause, "operator ")) {
    ++counts_.operator_lowerings;
    const bool approved = absl::StrContains(decision.reason, kApproved);
    if (approved) ++counts_.approved_lowerings;
    if (decision.from == "HALT" && !approved) {
      Fail("I1", "one operator alone lowers from HALT", ToString(decision.decision_id));
    }
    if (ordered_.contains(decision.reason)) return;
    return Fail("I1", "no operator ordered this lowering", ToString(decision.decision_id));
  }
  ++counts_.soft_lowerings;
  const bool soft_step = absl::StartsWith(decision.cause, "rule ") && decision.from == "ALERT" &&
                         LevelIndex(decision.to) == from - 1;
  if (!soft_step) return Fail("I1", "the level is lowered by accident", decision.cause);
  const auto later = std::ranges::upper_bound(began_ns_, lowering.made_ns);
  if (later == began_ns_.begin()) return;
  if (const int64_t quiet_ns = lowering.made_ns - *std::prev(later); quiet_ns < kSoftHoldNs) {
    Fail("I1", "a rule lowers without evidence for the whole hold",
         absl::StrCat(ToString(decision.decision_id), ", ", quiet_ns / kNanosPerMilli, " ms"));
  }
}

void Checker::OnRecord(const store::WriteBatch& batch, int64_t now_ns) {
  for (const store::DecisionRecord& decision : batch.decisions) {
    const auto [it, fresh] = decisions_.try_emplace(decision.decision_id);
    if (!fresh && it->second.record != decision) {
      Fail("I1", "one decision names two decisions", ToString(decision.decision_id));
    }
    if (!fresh) continue;
    if (!drawn_terms_.contains(decision.decision_id.term)) {
      Fail("I1", "a decision is of a term that the store never gave",
           ToString(decision.decision_id));
    }
    ++counts_.decisions;
    const bool lowers = LevelIndex(decision.to) < LevelIndex(decision.from);
    const auto held = held_since_ns_.find(decision.decision_id);
    it->second = {.record = decision,
                  .lowers = lowers,
                  .made_ns = held == held_since_ns_.end() ? now_ns : held->second};
    if (lowers) CheckLowering(it->second);
  }
  for (const store::StageUpdate& stage : batch.stages) {
    if (stage.stage == "verified" && !verified_.contains(stage.decision_id)) {
      Fail("I7", "a level is recorded as verified that was not read back",
           ToString(stage.decision_id));
    }
  }
}

void Checker::OnDurable(const store::WriteBatch& batch, const store::RobotRecord& record) {
  for (const store::DecisionRecord& each : batch.decisions)
    decisions_[each.decision_id].durable = true;
  for (const store::AlertRecord& alert : batch.alerts) durable_alerts_.insert(alert.id);
  const int level = LevelIndex(record.level);
  if (level < durable_level_ && !LoweredBetween(durable_decision_id_, record.decision_id)) {
    Fail("I1", "the recorded level sinks without a lowering", ToString(record.decision_id));
  }
  durable_decision_id_ = record.decision_id;
  durable_level_ = level;
  for (const auto& [lane, sequence] : record.high_water) {
    uint64_t& known = high_water_[lane];
    const std::vector<uint64_t>& ids = numbered_[lane];
    for (; known < sequence; ++known) {
      if (known >= ids.size()) return Fail("I3", "a sequence is recorded that no sensor gave");
      if (ids[known] == 0) continue;
      ++durable_judged_;
      judged_durably_.insert(ids[known]);
    }
  }
  const auto judged = record.variables.find("judged");
  const int64_t effects = judged == record.variables.end() ? 0 : std::get<int64_t>(judged->second);
  if (effects != durable_judged_) {
    Fail("I3", "recorded sequences and recorded effects differ",
         absl::StrCat(durable_judged_, " observations, ", effects, " effects"));
  }
}

void Checker::OnAlertTold(const std::string& id) {
  if (!durable_alerts_.contains(id)) Fail("I2", "an alert is told before it is durable", id);
}

void Checker::OnCommandSent(const pipeline::Command& command) {
  sent_terms_[command.id] = command.term;
  const auto* set = std::get_if<pipeline::SetLevel>(&command.what);
  if (set == nullptr) return;
  const auto decision = decisions_.find(set->decision_id);
  const bool known = decision != decisions_.end();
  if (known && decision->second.lowers && !decision->second.durable) {
    Fail("I2", "a lowering is sent before it is durable", ToString(set->decision_id));
  }
  const bool by_rule = known && absl::StartsWith(decision->second.record.cause, "rule ");
  // What a server finds durable at its start it commands; the actuator's floor waits for evidence.
  if (by_rule && decision->second.lowers && !commanded_.contains(set->decision_id) &&
      decision->second.made_ns >= server_began_ns_ && began_ns_.back() > decision->second.made_ns) {
    Fail("I1", "a rule's lowering leaves after its evidence began anew",
         ToString(set->decision_id));
  }
  commanded_.insert(set->decision_id);
  if (!set->based_on.none() && !LoweredBetween(set->based_on, set->decision_id)) {
    Fail("I2", "a command lowers the actuator without a durable lowering",
         ToString(set->decision_id));
  }
}

void Checker::OnOrderAnswered(const DecisionId& decision_id) {
  const auto decision = decisions_.find(decision_id);
  if (decision == decisions_.end() || !decision->second.durable) {
    Fail("I2", "an order is answered before it is durable", ToString(decision_id));
  }
}

void Checker::OnServerHolds(const DecisionId& decision_id, absl::string_view level,
                            int64_t now_ns) {
  held_since_ns_.try_emplace(decision_id, now_ns);
  const auto decision = decisions_.find(decision_id);
  if (decision != decisions_.end() && decision->second.record.to != level) {
    Fail("I1", "the server's level is not that of its decision", ToString(decision_id));
  }
  if (LevelIndex(level) < durable_level_ && decision_id <= durable_decision_id_) {
    Fail("I1", "the server holds less than what is durable", ToString(decision_id));
  }
}

// --- observations

void Checker::OnNumbered(const store::LaneKey& lane, uint64_t sequence, uint64_t id) {
  std::vector<uint64_t>& ids = numbered_[lane];
  counts_.resent += sequence <= ids.size() ? 1 : 0;
  if (ids.size() < sequence) ids.resize(sequence);
  ids[sequence - 1] = id;
}

void Checker::OnJudged(uint64_t id) {
  ++counts_.judged;
  if (!judged_.insert(id).second) {
    Fail("I3", "an observation is judged twice", absl::StrCat("observation ", id));
  }
}

void Checker::OnAcknowledged(const store::LaneKey& lane, uint64_t sequence) {
  if (sequence > high_water_[lane]) {
    Fail("I2", "an observation is acknowledged before it is durable",
         absl::StrCat("sequence ", sequence, ", durable ", high_water_[lane]));
  }
}

// --- the actuator

void Checker::OnActuatorStart(const ExecutorReport& report, int64_t now_ns) {
  held_ = report;
  newest_term_ = report.highest_term;
  newest_echo_ns_ = 0;
  lease_end_ns_ = now_ns + actuator::kStartGraceNs;
  evidence_complete_ = false;
  read_back_ = -1;
  stale_.clear();
}

void Checker::OnCommandDelivered(const std::string& id, uint64_t term) {
  if (term < newest_term_) stale_.insert(id);
  newest_term_ = std::max(newest_term_, term);
}

void Checker::OnLeaseDelivered(const model::LeaseGrant& lease, int64_t now_ns) {
  if (lease.term < newest_term_ || lease.echo_boottime_ns <= 0) return;
  if (lease.echo_boottime_ns > now_ns || lease.echo_boottime_ns < newest_echo_ns_) return;
  newest_term_ = lease.term;
  newest_echo_ns_ = lease.echo_boottime_ns;
  lease_end_ns_ = lease.echo_boottime_ns + lease.ttl_ms * kNanosPerMilli;
  evidence_complete_ = lease.evidence_complete;
}

void Checker::OnReceipt(const actuator::Receipt& receipt) {
  const bool refused = receipt.stage == actuator::Receipt::Stage::kRefusedStale;
  counts_.refused_stale += refused ? 1 : 0;
  const bool obeyed = receipt.stage == actuator::Receipt::Stage::kAcknowledged ||
                      receipt.stage == actuator::Receipt::Stage::kVerified;
  if (obeyed && stale_.contains(receipt.command_id)) {
    Fail("I1", "a command of an old term is obeyed after a newer term",
         absl::StrCat("term ", sent_terms_[receipt.command_id], ", newest ", newest_term_));
  }
  if (receipt.stage != actuator::Receipt::Stage::kVerified) return;
  ++counts_.verified;
  const auto decision = decisions_.find(receipt.decision_id);
  if (decision != decisions_.end() && read_back_ < LevelIndex(decision->second.record.to)) {
    Fail("I7", "a level is verified that was not read back", ToString(receipt.decision_id));
  }
  verified_.insert(receipt.decision_id);
}

void Checker::OnActuatorHolds(const ExecutorReport& report, int64_t now_ns) {
  const int effective = LevelIndex(report.effective);
  const int decided = LevelIndex(report.decided);
  if (effective < decided || effective < LevelIndex(report.floor)) {
    Fail("I1", "the actuator holds less than its decision or its floor", report.effective);
  }
  if (decided < LevelIndex(held_->decided) &&
      !LoweredBetween(held_->decision_id, report.decision_id)) {
    Fail("I1", "the level in force sinks without a durable lowering",
         absl::StrCat(ToString(held_->decision_id), " to ", ToString(report.decision_id)));
  }
  counts_.floors += held_->floor.empty() && !report.floor.empty() ? 1 : 0;
  const bool lease_over = now_ns >= lease_end_ns_;
  if (report.floor.empty() && !held_->floor.empty()) {
    ++counts_.lifted;
    if (lease_over || !evidence_complete_) Fail("I5", "a floor lifts without a lease", "");
  }
  if (now_ns > lease_end_ns_ + kTickNs && effective < kFailSafe) {
    Fail("I5", "without a lease the actuator is below its fail-safe level", report.effective);
  }
  if (report.verified && read_back_ != effective) {
    Fail("I7", "the actuator calls a level verified that was not read back", report.effective);
  }
  if (report.verified && !report.decision_id.none()) verified_.insert(report.decision_id);
  held_ = report;
}

}  // namespace rips::simulation
