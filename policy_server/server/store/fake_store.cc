#include "policy_server/server/store/fake_store.h"

#include <algorithm>
#include <variant>

#include "absl/strings/match.h"
#include "services/base/status_macros.h"

namespace rips::store {
namespace {

TransitionRecord ToTransition(const std::string& robot, const DecisionRecord& decision) {
  return {.id = decision.id,
          .robot = robot,
          .time_unix_ns = decision.time_unix_ns,
          .from = decision.from,
          .to = decision.to,
          .cause = decision.cause,
          .reason = decision.reason,
          .decision_id = decision.decision_id,
          .based_on = decision.based_on,
          .stage = "requested",
          .trace = decision.trace};
}

TransitionRecord ToTransition(const std::string& robot, const RefusalRecord& refusal) {
  return {.id = refusal.id,
          .robot = robot,
          .time_unix_ns = refusal.time_unix_ns,
          .from = refusal.from,
          .to = refusal.to,
          .cause = refusal.cause,
          .reason = refusal.reason,
          .refused = true,
          .count = refusal.count,
          .trace = refusal.trace};
}

template <typename Record>
std::vector<Record> Newest(const std::vector<Record>& records, absl::string_view robot,
                           uint32_t limit) {
  std::vector<Record> out;
  for (auto it = records.rbegin(); it != records.rend() && out.size() < ListLimit(limit); ++it) {
    if (robot.empty() || it->robot == robot) out.push_back(*it);
  }
  return out;
}

std::vector<RuleDecision> RuleDecisions(const std::vector<TransitionRecord>& transitions,
                                        absl::string_view robot, const DecisionId& after) {
  std::vector<RuleDecision> out;
  for (const TransitionRecord& each : transitions) {
    if (each.robot != robot || each.refused || each.decision_id <= after) continue;
    if (!absl::StartsWith(each.cause, "rule ")) continue;
    out.push_back({each.decision_id, each.from, each.to, each.time_unix_ns});
  }
  std::sort(out.begin(), out.end(),
            [](const auto& a, const auto& b) { return a.decision_id < b.decision_id; });
  if (out.size() > kRuleDecisionsMax) out.erase(out.begin(), out.end() - kRuleDecisionsMax);
  return out;
}

}  // namespace

void FakeStore::FailWrites(absl::Status status) {
  MutexLock lock(&mutex_);
  write_status_ = std::move(status);
}

void FakeStore::FillDisk(bool full) {
  MutexLock lock(&mutex_);
  full_ = full;
}

void FakeStore::FailReads(absl::Status status) {
  MutexLock lock(&mutex_);
  read_status_ = std::move(status);
}

void FakeStore::OnCommit(std::function<void()> hook) {
  MutexLock lock(&mutex_);
  on_commit_ = std::move(hook);
}

std::vector<size_t> FakeStore::commit_sizes() const {
  MutexLock lock(&mutex_);
  return commit_sizes_;
}

void FakeStore::OnQuestion(std::function<void()> hook) {
  MutexLock lock(&mutex_);
  on_question_ = std::move(hook);
}

void FakeStore::Question() {
  std::function<void()> hook;
  {
    MutexLock lock(&mutex_);
    hook = on_question_;
  }
  if (hook) hook();
}

absl::StatusOr<RobotRecord> FakeStore::Load(absl::string_view robot) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  return state_.Record(robot);
}

RobotRecord FakeStore::State::Record(absl::string_view robot) const {
  const auto it = robots.find(robot);
  if (it == robots.end()) return RobotRecord{};
  RobotRecord record = it->second;
  record.rule_decisions = RuleDecisions(transitions, robot, record.resumed_at);
  return record;
}

absl::StatusOr<std::vector<Acquired>> FakeStore::Acquire(std::span<const std::string> robots) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(write_status_);
  RIPS_RETURN_IF_ERROR(read_status_);
  std::vector<Acquired> acquired;
  for (const std::string& robot : robots) {
    const uint64_t tenure = ++state_.robots[robot].highest_term;
    state_.tenures[robot] = tenure;
    acquired.push_back({.record = state_.Record(robot), .tenure = tenure});
  }
  return acquired;
}

absl::Status FakeStore::State::CheckTenure(absl::string_view robot, uint64_t tenure) const {
  const auto it = tenures.find(robot);
  const uint64_t stored = it == tenures.end() ? 0 : it->second;
  if (tenure != 0 && tenure == stored) return absl::OkStatus();
  return Fenced(robot, tenure, stored);
}

absl::StatusOr<uint64_t> FakeStore::NextTerm(absl::string_view robot, uint64_t tenure,
                                             uint64_t above) {
  Question();
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(write_status_);
  RIPS_RETURN_IF_ERROR(state_.CheckTenure(robot, tenure));
  RobotRecord& record = state_.robots[std::string(robot)];
  record.highest_term = std::max(record.highest_term, std::min(above, kTermAboveMax)) + 1;
  return record.highest_term;
}

absl::StatusOr<std::optional<std::string>> FakeStore::FindDecision(absl::string_view robot,
                                                                   const DecisionId& decision_id) {
  Question();
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  for (const TransitionRecord& each : state_.transitions) {
    if (each.robot == robot && !each.refused && each.decision_id == decision_id) return each.to;
  }
  return std::nullopt;
}

absl::Status FakeStore::BeginGeneration(absl::string_view id) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(write_status_);
  RIPS_RETURN_IF_ERROR(CheckGeneration(id));
  std::vector<Generation>& generations = state_.generations;
  for (const Generation& known : generations) {
    if (known.id == id) return absl::AlreadyExistsError("the store has this generation");
  }
  const uint64_t commit = generations.empty() ? 0 : generations.back().last_commit;
  generations.push_back({.id = std::string(id), .last_commit = commit});
  if (generations.size() > kGenerationsMax) generations.erase(generations.begin());
  return absl::OkStatus();
}

absl::StatusOr<std::vector<Generation>> FakeStore::Generations() {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  return state_.generations;
}

uint64_t FakeStore::newest_commit() const {
  MutexLock lock(&mutex_);
  return state_.generations.empty() ? 0 : state_.generations.back().last_commit;
}

absl::StatusOr<std::vector<absl::Status>> FakeStore::CommitAll(
    std::span<const WriteBatch> batches) {
  std::function<void()> hook;
  {
    MutexLock lock(&mutex_);
    hook = on_commit_;
  }
  if (hook) hook();
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(write_status_);
  if (full_ && !std::all_of(batches.begin(), batches.end(),
                            [](const WriteBatch& batch) { return batch.uses_reserve; })) {
    return absl::ResourceExhaustedError("the disk is full");
  }
  std::vector<absl::Status> statuses;
  bool written = false;
  for (const WriteBatch& batch : batches) {
    // Nothing else can be refused half way.
    const bool may_clash =
        !batch.decisions.empty() || !batch.refusals.empty() || !batch.acks.empty();
    State before = may_clash ? state_ : State();
    statuses.push_back(state_.Apply(batch));
    written |= statuses.back().ok();
    if (!statuses.back().ok() && may_clash) state_ = std::move(before);
  }
  if (written && !state_.generations.empty()) ++state_.generations.back().last_commit;
  commit_sizes_.push_back(batches.size());
  return statuses;
}

absl::Status FakeStore::State::Apply(const WriteBatch& batch) {
  RIPS_RETURN_IF_ERROR(Validate(batch));
  if (batch.tenure != 0) RIPS_RETURN_IF_ERROR(CheckTenure(batch.robot, batch.tenure));
  const std::string& robot = batch.robot;
  for (const DecisionRecord& each : batch.decisions) RIPS_RETURN_IF_ERROR(Apply(robot, each));
  for (const RefusalRecord& each : batch.refusals) RIPS_RETURN_IF_ERROR(Apply(robot, each));
  for (const StageUpdate& each : batch.stages) Apply(robot, each);
  for (const AlertRecord& each : batch.alerts) Apply(each);
  for (const ReceiptRecord& each : batch.receipts) Apply(robot, each);
  for (const AckRecord& each : batch.acks) RIPS_RETURN_IF_ERROR(Apply(each));
  if (!batch.checkpoint.empty()) Apply(robot, batch.checkpoint);
  return absl::OkStatus();
}

absl::Status FakeStore::State::Apply(const std::string& robot, const DecisionRecord& decision) {
  for (const TransitionRecord& known : transitions) {
    const bool same_decision_id = known.robot == robot && known.decision_id == decision.decision_id;
    if (!same_decision_id && known.id != decision.id) continue;
    TransitionRecord stored = known;
    stored.stage = "requested";
    stored.detail.clear();
    stored.trace = decision.trace;
    if (stored == ToTransition(robot, decision)) return absl::OkStatus();
    return absl::AlreadyExistsError("the decision or id names another decision");
  }
  transitions.push_back(ToTransition(robot, decision));
  RobotRecord& record = robots[robot];
  record.highest_term = std::max(record.highest_term, decision.decision_id.term);
  if (decision.decision_id > record.decision_id) {
    record.decision_id = decision.decision_id;
    record.level = decision.to;
  }
  return absl::OkStatus();
}

absl::Status FakeStore::State::Apply(const std::string& robot, const RefusalRecord& refusal) {
  for (TransitionRecord& known : transitions) {
    if (known.id != refusal.id) continue;
    if (!known.refused || known.robot != robot) {
      return absl::AlreadyExistsError("the id names another transition");
    }
    known.count = refusal.count;
    known.reason = refusal.reason;
    known.time_unix_ns = refusal.time_unix_ns;
    return absl::OkStatus();
  }
  transitions.push_back(ToTransition(robot, refusal));
  return absl::OkStatus();
}

void FakeStore::State::Apply(const std::string& robot, const StageUpdate& update) {
  for (TransitionRecord& known : transitions) {
    if (known.robot != robot || known.refused || known.decision_id != update.decision_id) continue;
    if (known.stage == "verified" && update.stage == "superseded") continue;
    known.stage = update.stage;
    known.detail = update.detail;
  }
}

void FakeStore::State::Apply(const std::string& robot, const ReceiptRecord& receipt) {
  std::vector<ReceiptRecord>& known = receipts[robot];
  std::erase_if(known, [&](const ReceiptRecord& each) {
    return each.host == receipt.host && each.receipt.command_id == receipt.receipt.command_id;
  });
  known.push_back(receipt);
  if (known.size() > kReceiptsPerRobotMax) known.erase(known.begin());
}

void FakeStore::State::Apply(const AlertRecord& alert) {
  const auto same = [&](const AlertRecord& known) { return known.id == alert.id; };
  if (std::none_of(alerts.begin(), alerts.end(), same)) alerts.push_back(alert);
}

absl::Status FakeStore::State::Apply(const AckRecord& record) {
  const auto is_it = [&](const AlertRecord& alert) { return alert.id == record.alert_id; };
  if (std::none_of(alerts.begin(), alerts.end(), is_it)) return NoSuchAlert(record.alert_id);
  acks.try_emplace(record.alert_id, record.ack);
  return absl::OkStatus();
}

void FakeStore::State::Apply(const std::string& robot, const Checkpoint& checkpoint) {
  RobotRecord& record = robots[robot];
  if (checkpoint.variables.has_value()) record.variables = *checkpoint.variables;
  if (checkpoint.soft_suspended.has_value()) record.soft_suspended = *checkpoint.soft_suspended;
  if (checkpoint.rules_halted.has_value()) record.rules_halted = *checkpoint.rules_halted;
  if (checkpoint.resumed_at.has_value()) record.resumed_at = *checkpoint.resumed_at;
  if (checkpoint.bundle.has_value()) record.bundle = *checkpoint.bundle;
  if (checkpoint.maintenance.has_value()) record.maintenance = *checkpoint.maintenance;
  std::vector<LaneKey>& order = lanes[robot];
  for (const auto& [key, sequence] : checkpoint.high_water) {
    if (!record.high_water.contains(key)) order.push_back(key);
    uint64_t& stored = record.high_water[key];
    stored = std::max(stored, sequence);

    const std::string& host = key.host;
    const auto of_host = [&host](const LaneKey& lane) { return lane.host == host; };
    if (std::count_if(order.begin(), order.end(), of_host) > ptrdiff_t{kHighWaterPerHostMax}) {
      const auto oldest = std::find_if(order.begin(), order.end(), of_host);
      record.high_water.erase(*oldest);
      order.erase(oldest);
    }
  }
}

absl::StatusOr<std::vector<TransitionRecord>> FakeStore::ListTransitions(absl::string_view robot,
                                                                         uint32_t limit) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  if (robot.empty()) return std::vector<TransitionRecord>();
  return Newest(state_.transitions, robot, limit);
}

absl::StatusOr<std::vector<AlertRecord>> FakeStore::ListAlerts(absl::string_view robot,
                                                               uint32_t limit) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  return Newest(state_.alerts, robot, limit);
}

absl::StatusOr<std::vector<ReceiptRecord>> FakeStore::ListReceipts(absl::string_view robot,
                                                                   uint32_t limit) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  const auto found = state_.receipts.find(robot);
  if (found == state_.receipts.end()) return std::vector<ReceiptRecord>();
  std::vector<ReceiptRecord> out(found->second.rbegin(), found->second.rend());
  if (out.size() > ListLimit(limit)) out.resize(ListLimit(limit));
  return out;
}

absl::StatusOr<AlertPage> FakeStore::AlertsAfter(absl::string_view robot, uint64_t sequence,
                                                 uint32_t limit) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  AlertPage page;
  for (uint64_t i = sequence; i < state_.alerts.size() && page.alerts.size() < ListLimit(limit);
       ++i) {
    if (!robot.empty() && state_.alerts[i].robot != robot) continue;
    page.alerts.push_back(state_.alerts[i]);
    page.alerts.back().sequence = i + 1;
  }
  return page;
}

absl::StatusOr<FoundRecords> FakeStore::FindRecords(absl::string_view prefix) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  const auto find = [&](const auto& records, auto& found) {
    for (const auto& record : records) {
      if (absl::StartsWith(record.id, prefix) && found.size() < 2) found.push_back(record);
    }
  };
  FoundRecords found;
  find(state_.alerts, found.alerts);
  find(state_.transitions, found.transitions);
  return found;
}

absl::StatusOr<uint64_t> FakeStore::FindAlert(absl::string_view id) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  for (size_t i = 0; i < state_.alerts.size(); ++i) {
    if (state_.alerts[i].id == id) return uint64_t{i + 1};
  }
  return 0;
}

absl::StatusOr<AlertRecord> FakeStore::NewestAlert() {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  if (state_.alerts.empty()) return AlertRecord{};
  AlertRecord newest = state_.alerts.back();
  newest.sequence = state_.alerts.size();
  return newest;
}

absl::StatusOr<std::string> FakeStore::Note(absl::string_view name) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  const auto it = state_.notes.find(name);
  return it == state_.notes.end() ? "" : it->second;
}

absl::Status FakeStore::SetNote(absl::string_view name, absl::string_view value) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(write_status_);
  RIPS_RETURN_IF_ERROR(CheckNote(name, value));
  state_.notes[std::string(name)] = std::string(value);
  return absl::OkStatus();
}

absl::Status FakeStore::PutBan(const BanRecord& ban) {
  if (ban.uri.empty()) return absl::InvalidArgumentError("a ban needs a URI");
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(write_status_);
  bans_[{ban.uri, ban.serial}] = ban;
  return absl::OkStatus();
}

absl::StatusOr<bool> FakeStore::RemoveBan(absl::string_view uri, absl::string_view serial) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(write_status_);
  return bans_.erase({std::string(uri), std::string(serial)}) > 0;
}

absl::StatusOr<std::vector<BanRecord>> FakeStore::ListBans() {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  std::vector<BanRecord> bans;
  for (const auto& [key, ban] : bans_) bans.push_back(ban);
  return bans;
}

absl::StatusOr<std::vector<AckRecord>> FakeStore::FindAcks(std::span<const std::string> alert_ids) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  std::vector<AckRecord> acks;
  for (const std::string& id : alert_ids) {
    const auto found = state_.acks.find(id);
    if (found != state_.acks.end()) acks.push_back({.alert_id = id, .ack = found->second});
  }
  return acks;
}

absl::StatusOr<AlertList> FakeStore::SearchAlerts(const AlertQuery& query) {
  MutexLock lock(&mutex_);
  RIPS_RETURN_IF_ERROR(read_status_);
  std::vector<AlertRecord> wanted;
  for (const AlertRecord& alert : state_.alerts) {
    if (query.open && state_.acks.contains(alert.id)) continue;
    if (Matches(query, alert)) wanted.push_back(alert);
  }
  return AlertList{.alerts = Newest(wanted, query.robot, query.limit)};
}

}  // namespace rips::store
