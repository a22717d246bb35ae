#include "policy_server/server/robot/actuators/command_reconciler.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/server/robot/actuators/receipt_history.h"

namespace rips::pipeline {

absl::string_view ToString(Stage stage) {
  switch (stage) {
    case Stage::kRequested:
      return "requested";
    case Stage::kAcknowledged:
      return "acknowledged";
    case Stage::kVerified:
      return "verified";
    case Stage::kFailed:
      return "failed";
    case Stage::kContradicted:
      return "contradicted";
  }
  return "";
}

CommandReconciler::CommandReconciler(std::vector<std::string> hosts, IdSource* ids,
                                     LedgerTiming timing)
    : ids_(ids), timing_(timing) {
  for (std::string& host : hosts) actuators_[std::move(host)] = Actuator{};
}

void CommandReconciler::SetHosts(const std::vector<std::string>& hosts) {
  absl::btree_map<std::string, Actuator> listed;
  for (const std::string& host : hosts) {
    const auto it = actuators_.find(host);
    listed[host] = it == actuators_.end() ? Actuator{} : std::move(it->second);
  }
  actuators_ = std::move(listed);
}

void CommandReconciler::Order(const DecisionId& decision_id, levels::LevelIndex level,
                              const std::string& level_name, const std::string& cause,
                              bool lowers) {
  if (decision_id == decision_id_) return;
  decision_id_ = decision_id;
  level_ = level;
  level_name_ = level_name;
  cause_ = cause;
  lowers_ = lowers;
  orders_.push_back({.decision_id = decision_id, .level = level, .level_name = level_name});
  if (orders_.size() > kOrdersKept) orders_.pop_front();
  for (auto& [host, actuator] : actuators_) {
    StartAnew(actuator);
  }
}

void CommandReconciler::StartAnew(Actuator& actuator) const {
  actuator.stage = Stage::kRequested;
  actuator.failure.clear();
  actuator.command_id.clear();
  actuator.sent_ns = actuator.first_sent_ns = actuator.retry_at_ns = 0;
}

void CommandReconciler::Hold(Actuator& actuator, const DecisionId& decision_id) const {
  if (decision_id < actuator.held) return;
  for (const Ordered& order : orders_) {
    if (order.decision_id != decision_id) continue;
    actuator.held = decision_id;
    actuator.held_level = order.level;
    actuator.held_name = order.level_name;
  }
}

std::optional<std::string> CommandReconciler::OrderedLevel(const DecisionId& decision_id) const {
  for (const Ordered& order : orders_) {
    if (order.decision_id == decision_id) return order.level_name;
  }
  return std::nullopt;
}

void CommandReconciler::Fail(Actuator& actuator, const std::string& why, Instant now) const {
  actuator.stage = Stage::kFailed;
  actuator.retry_at_ns = now.boottime_ns + timing_.retry_ns;
  actuator.failure = why;
}

void CommandReconciler::Attach(const std::string& host, const DecisionId& held,
                               levels::LevelIndex held_level, const std::string& held_name,
                               std::vector<std::string> programs, Instant now) {
  Actuator& actuator = actuators_[host];
  actuator.attached = true;
  actuator.beaten = false;
  actuator.old_failure.clear();
  actuator.held = held;
  actuator.held_level = held_level;
  actuator.held_name = held_name;
  actuator.programs = std::move(programs);
  // Whatever was reported in an earlier session, the read-back is asked for again.
  StartAnew(actuator);
  if (!decision_id_.none() && held == decision_id_ && held_level == level_) {
    actuator.stage = Stage::kAcknowledged;
    actuator.first_sent_ns = now.boottime_ns;
  }
}

void CommandReconciler::Detach(const std::string& host) {
  Actuator& actuator = actuators_[host];
  actuator.attached = false;
  actuator.stage = Stage::kRequested;
}

bool CommandReconciler::attached(const std::string& host) const {
  const auto it = actuators_.find(host);
  return it != actuators_.end() && it->second.attached;
}

bool CommandReconciler::Offers(const Actuator& actuator, const std::string& program) {
  return actuator.programs.has_value() &&
         std::find(actuator.programs->begin(), actuator.programs->end(), program) !=
             actuator.programs->end();
}

std::vector<std::string> CommandReconciler::NotOffered(
    const std::vector<std::string>& programs) const {
  std::vector<std::string> missing;
  for (const auto& [host, actuator] : actuators_) {
    if (!actuator.programs.has_value()) return missing;
  }
  for (const std::string& program : programs) {
    const bool offered = std::any_of(actuators_.begin(), actuators_.end(), [&](const auto& each) {
      return Offers(each.second, program);
    });
    if (!offered) missing.push_back(program);
  }
  return missing;
}

bool CommandReconciler::Run(uint64_t run_id, const std::string& program,
                            const std::vector<std::string>& args, Instant now) {
  for (const auto& [host, actuator] : actuators_) {
    if (!actuator.attached || !Offers(actuator, program)) continue;
    runs_[run_id] = {
        .command_id = ids_->Next(),
        .host = host,
        .program = {.program = program,
                    .args = args,
                    .timeout_ms = static_cast<uint32_t>(timing_.program_ns / kNanosPerMilli)},
        .started_ns = now.boottime_ns};
    return true;
  }
  return false;
}

ReceiptResult CommandReconciler::OnReceipt(const std::string& host, const Receipt& receipt,
                                           Instant now) {
  for (const auto& [run_id, run] : runs_) {
    if (run.host == host && run.command_id == receipt.command_id) {
      return OnProgramReceipt(run_id, receipt);
    }
  }
  Actuator& actuator = actuators_[host];
  ReceiptResult result;
  const bool obeyed =
      receipt.stage == Receipt::Stage::kAcknowledged || receipt.stage == Receipt::Stage::kVerified;
  // Also of a decision that has been overtaken: what comes next is based on it.
  if (!receipt.decision_id.none() && obeyed) Hold(actuator, receipt.decision_id);
  if (receipt.decision_id.none() || receipt.decision_id != decision_id_) return result;
  if (receipt.stage == Receipt::Stage::kFailed && !actuator.beaten &&
      receipt.command_id != actuator.command_id) {
    // It may be minutes old: the first heartbeat says whether the level holds.
    actuator.old_failure = absl::StrCat(host, ": ", FailureText(receipt));
    return result;
  }
  const Stage before = actuator.stage;
  switch (receipt.stage) {
    case Receipt::Stage::kAcknowledged:
      if (before == Stage::kRequested) actuator.stage = Stage::kAcknowledged;
      break;
    case Receipt::Stage::kVerified:
      actuator.stage = Stage::kVerified;
      actuator.failure.clear();
      break;
    case Receipt::Stage::kFailed:
      // Not held by that alone: a lowering that could not be recorded was never acknowledged.
      Fail(actuator, absl::StrCat(host, ": ", FailureText(receipt)), now);
      break;
    case Receipt::Stage::kRefusedStale:
      result.stale_term = true;
      [[fallthrough]];
    case Receipt::Stage::kRefused:
    case Receipt::Stage::kUnknown:
      Fail(actuator, absl::StrCat(host, ": ", FailureText(receipt)), now);
      break;
    case Receipt::Stage::kSuperseded:
      // Of the newest decision: a repeat of our own order overtook it; its own receipt follows.
      break;
  }
  result.level_changed_stage = actuator.stage != before;
  result.detail = FailureText(receipt);
  return result;
}

ReceiptResult CommandReconciler::OnProgramReceipt(uint64_t run_id, const Receipt& receipt) {
  ReceiptResult result;
  if (receipt.stage == Receipt::Stage::kAcknowledged) return result;
  const bool ok = receipt.stage == Receipt::Stage::kVerified && receipt.exit_code == 0;
  result.program = ProgramResult{.run_id = run_id, .ok = ok, .detail = FailureText(receipt)};
  runs_.erase(run_id);
  return result;
}

bool CommandReconciler::OnHeartbeat(const std::string& host, levels::LevelIndex effective,
                                    bool verified, Instant now) {
  Actuator& actuator = actuators_[host];
  actuator.beaten = true;
  const std::string old_failure = std::exchange(actuator.old_failure, "");
  if (actuator.held != decision_id_) return false;
  const bool reached = verified && (effective == level_ || (effective > level_ && !lowers_));
  if (actuator.stage == Stage::kVerified && !reached) {
    actuator.stage = Stage::kAcknowledged;
    actuator.first_sent_ns = 0;
    return true;
  }
  if (reached && actuator.stage != Stage::kRequested) {
    actuator.stage = Stage::kVerified;
    actuator.failure.clear();
  } else if (!reached && !old_failure.empty()) {
    Fail(actuator, old_failure, now);
  }
  return false;
}

std::optional<Command> CommandReconciler::LevelCommandDue(Actuator& actuator, uint64_t term,
                                                          Instant now) {
  if (!actuator.attached || actuator.stage == Stage::kVerified) return std::nullopt;
  const int64_t now_ns = now.boottime_ns;
  if (actuator.stage == Stage::kAcknowledged) {
    const bool overdue =
        actuator.first_sent_ns != 0 && now_ns - actuator.first_sent_ns >= timing_.command_ns;
    if (overdue) Fail(actuator, "no final receipt within the budget of a level command", now);
    return std::nullopt;
  }
  if (actuator.stage == Stage::kFailed) {
    if (now_ns < actuator.retry_at_ns) return std::nullopt;
    // A new attempt; the stage stays `failed` until the actuator says better.
    actuator.command_id.clear();
    actuator.retry_at_ns = now_ns + timing_.command_ns;
  } else if (!actuator.command_id.empty() && now_ns - actuator.sent_ns < timing_.resend_ns) {
    return std::nullopt;
  }
  if (actuator.command_id.empty()) {
    actuator.command_id = ids_->Next();
    actuator.first_sent_ns = now_ns;
  }
  actuator.sent_ns = now_ns;
  SetLevel set{
      .decision_id = decision_id_, .from = actuator.held_name, .to = level_name_, .cause = cause_};
  if (level_ < actuator.held_level) set.based_on = actuator.held;
  return Command{.id = actuator.command_id,
                 .term = term,
                 .ttl_ms = static_cast<uint32_t>(timing_.command_ns / kNanosPerMilli),
                 .what = std::move(set)};
}

std::vector<Outgoing> CommandReconciler::Due(uint64_t term, Instant now) {
  std::vector<Outgoing> due;
  if (!decision_id_.none()) {
    for (auto& [host, actuator] : actuators_) {
      if (auto command = LevelCommandDue(actuator, term, now)) {
        due.push_back({.host = host, .command = *std::move(command)});
      }
    }
  }
  for (auto& [run_id, run] : runs_) {
    if (run.sent) continue;
    run.sent = true;
    due.push_back({.host = run.host,
                   .command = {.id = run.command_id,
                               .term = term,
                               .ttl_ms = run.program.timeout_ms,
                               .what = run.program}});
  }
  return due;
}

std::vector<ProgramResult> CommandReconciler::ExpiredPrograms(Instant now) {
  std::vector<ProgramResult> expired;
  for (auto it = runs_.begin(); it != runs_.end();) {
    const bool late = now.boottime_ns - it->second.started_ns > timing_.program_ns;
    if (!late && attached(it->second.host)) {
      ++it;
      continue;
    }
    expired.push_back({.run_id = it->first,
                       .ok = false,
                       .detail = late ? "no result in time" : "the actuator has gone"});
    it = runs_.erase(it);
  }
  return expired;
}

Stage CommandReconciler::stage() const {
  bool all_acknowledged = !actuators_.empty();
  bool all_verified = !actuators_.empty();
  for (const auto& [host, actuator] : actuators_) {
    if (actuator.stage == Stage::kFailed) return Stage::kFailed;
    if (actuator.stage != Stage::kVerified) all_verified = false;
    if (actuator.stage == Stage::kRequested) all_acknowledged = false;
  }
  if (all_verified) return Stage::kVerified;
  return all_acknowledged ? Stage::kAcknowledged : Stage::kRequested;
}

std::string CommandReconciler::failure() const {
  for (const auto& [host, actuator] : actuators_) {
    if (actuator.stage == Stage::kFailed) return actuator.failure;
  }
  return "";
}

}  // namespace rips::pipeline
