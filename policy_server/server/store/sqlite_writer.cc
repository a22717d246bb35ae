#include "policy_server/server/store/sqlite_writer.h"

#include <algorithm>
#include <bit>
#include <utility>
#include <variant>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/store/trace_codec.h"
#include "services/base/status_macros.h"
#include "services/model_proto/actuator_codec.h"

namespace rips::store {
namespace {

// One in so many of the alerts that a robot keeps is a grave one that would be forgotten.
constexpr int64_t kGraveShare = 10;

}  // namespace

absl::StatusOr<SqliteWriter> SqliteWriter::Create(const std::string& path, SqliteLimits limits) {
  RIPS_ASSIGN_OR_RETURN(Database db, Database::Open(path, Database::Mode::kReadWrite));
  RIPS_ASSIGN_OR_RETURN(const std::string mode, db.Ask("PRAGMA journal_mode = WAL"));
  if (mode != "wal") {
    return absl::UnavailableError(absl::StrCat("state file `", path,
                                               "` cannot use a write-ahead log (journal mode `",
                                               mode, "`); put it on a local file system"));
  }
  // FULL: the log is synced at each commit, so OK means durable.
  RIPS_RETURN_IF_ERROR(db.Execute("PRAGMA synchronous = FULL"));
  SqliteWriter writer(std::move(db), limits);
  RIPS_RETURN_IF_ERROR(writer.PrepareAll());
  return writer;
}

absl::Status SqliteWriter::PrepareAll() {
  const std::pair<Statement*, const char*> statements[] = {
      {&begin_, "BEGIN IMMEDIATE"},
      {&commit_, "COMMIT"},
      {&rollback_, "ROLLBACK"},
      {&begin_batch_, "SAVEPOINT batch"},
      {&rollback_batch_, "ROLLBACK TO batch"},
      {&end_batch_, "RELEASE batch"},
      {&add_robot_, "INSERT INTO robots (robot) VALUES (?) ON CONFLICT DO NOTHING"},
      {&acquire_,
       "UPDATE robots SET highest_term = highest_term + 1, tenure = highest_term + 1 "
       "WHERE robot = ? RETURNING tenure"},
      {&tenure_, "SELECT tenure FROM robots WHERE robot = ?"},
      {&next_term_,
       "UPDATE robots SET highest_term = max(highest_term, ?2) + 1 WHERE robot = ?1 "
       "RETURNING highest_term"},
      {&find_decision_,
       "SELECT id, robot, time_unix_ns, from_level, to_level, cause, reason, refused, term, epoch,"
       " based_term, based_epoch FROM transitions "
       "WHERE id = ?1 OR (robot = ?2 AND term = ?3 AND epoch = ?4 AND refused = 0)"},
      {&add_decision_,
       "INSERT INTO transitions (id, robot, time_unix_ns, from_level, to_level, cause, reason,"
       " refused, term, epoch, based_term, based_epoch, count, stage, detail, trace) "
       "VALUES (?, ?, ?, ?, ?, ?, ?, 0, ?, ?, ?, ?, 1, 'requested', '', ?)"},
      {&apply_decision_,
       "UPDATE robots SET highest_term = max(highest_term, ?2), "
       "level = iif((?2, ?3) > (term, epoch), ?4, level), "
       "term = iif((?2, ?3) > (term, epoch), ?2, term), "
       "epoch = iif((?2, ?3) > (term, epoch), ?3, epoch) WHERE robot = ?1"},
      {&put_refusal_,
       "INSERT INTO transitions (id, robot, time_unix_ns, from_level, to_level, cause, reason,"
       " refused, term, epoch, based_term, based_epoch, count, stage, detail, trace) "
       "VALUES (?, ?, ?, ?, ?, ?, ?, 1, 0, 0, 0, 0, ?, '', '', ?) "
       "ON CONFLICT (id) DO UPDATE SET time_unix_ns = excluded.time_unix_ns, "
       "reason = excluded.reason, count = excluded.count"
       " WHERE refused = 1 AND robot = excluded.robot RETURNING seq"},
      {&prune_refusals_,
       "DELETE FROM transitions WHERE refused = 1 AND"
       " seq <= (SELECT max(seq) FROM transitions) - ?"},
      {&set_stage_,
       "UPDATE transitions SET stage = ?4, detail = ?5 "
       "WHERE robot = ?1 AND term = ?2 AND epoch = ?3 AND refused = 0"
       " AND NOT (stage = 'verified' AND ?4 = 'superseded')"},
      {&add_alert_,
       "INSERT INTO alerts (id, time_unix_ns, robot, rule, severity, text, level, event, term,"
       " epoch, trace, maintenance) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (id) "
       "DO NOTHING"},
      // A repeated one goes to the end of the order.
      {&put_receipt_,
       "INSERT OR REPLACE INTO receipts (robot, host, command_id, command, time_unix_ns, receipt) "
       "VALUES (?, ?, ?, ?, ?, ?)"},
      {&prune_receipts_,
       "DELETE FROM receipts WHERE robot = ?1 AND seq <= (SELECT seq FROM receipts "
       "WHERE robot = ?1 ORDER BY seq DESC LIMIT 1 OFFSET ?2)"},
      {&find_prune_, "SELECT seq FROM alerts WHERE robot = ? ORDER BY seq DESC LIMIT 1 OFFSET ?"},
      // Of the grave ones ?3 are kept however many of less severity came later.
      {&prune_alerts_,
       "DELETE FROM alerts WHERE robot = ?1 AND seq <= ?2 AND "
       "(severity NOT IN ('high', 'critical') OR seq <= ifnull((SELECT seq FROM alerts WHERE "
       "robot = ?1 AND severity IN ('high', 'critical') ORDER BY seq DESC LIMIT 1 OFFSET ?3), 0))"},
      {&note_prune_, "UPDATE robots SET alerts_forgotten = ?2 WHERE robot = ?1"},
      {&set_note_,
       "INSERT INTO notes (name, value) VALUES (?, ?) "
       "ON CONFLICT (name) DO UPDATE SET value = excluded.value"},
      {&set_bundle_, "UPDATE robots SET bundle = ?2 WHERE robot = ?1"},
      {&clear_variables_, "DELETE FROM variables WHERE robot = ?"},
      {&add_variable_,
       "INSERT INTO variables (robot, name, kind, number, text) VALUES (?, ?, ?, ?, ?)"},
      {&set_suspended_, "UPDATE robots SET soft_suspended = ?2 WHERE robot = ?1"},
      {&set_halted_, "UPDATE robots SET rules_halted = ?2 WHERE robot = ?1"},
      {&put_high_water_,
       "INSERT INTO high_water (robot, host, incarnation, lane, sequence) VALUES (?, ?, ?, ?, ?) "
       "ON CONFLICT (robot, host, incarnation, lane) "
       "DO UPDATE SET sequence = max(sequence, excluded.sequence)"},
      {&prune_high_water_,
       "DELETE FROM high_water WHERE robot = ?1 AND host = ?2 AND seq <= (SELECT seq FROM "
       "high_water WHERE robot = ?1 AND host = ?2 ORDER BY seq DESC LIMIT 1 OFFSET ?3)"},
      {&put_maintenance_,
       "INSERT OR REPLACE INTO maintenance (robot, began_unix_ns, until_unix_ns, by, reason) "
       "VALUES (?, ?, ?, ?, ?)"},
      {&end_maintenance_, "DELETE FROM maintenance WHERE robot = ?"},
      {&put_ban_,
       "INSERT INTO bans (uri, serial, reason, by, time_unix_ns) VALUES (?, ?, ?, ?, ?) "
       "ON CONFLICT (uri, serial) DO UPDATE SET reason = excluded.reason, by = excluded.by,"
       " time_unix_ns = excluded.time_unix_ns"},
      {&remove_ban_, "DELETE FROM bans WHERE uri = ? AND serial = ? RETURNING 1"},
      {&add_ack_,
       "UPDATE alerts SET ack_by = ?2, ack_note = ?3, ack_unix_ns = ?4 "
       "WHERE id = ?1 AND ack_unix_ns = 0 RETURNING 1"},
      {&find_alert_, "SELECT 1 FROM alerts WHERE id = ?"},
      {&set_resumed_, "UPDATE robots SET resumed_term = ?2, resumed_epoch = ?3 WHERE robot = ?1"},
      {&add_generation_,
       "INSERT INTO generations (id, last_commit) "
       "SELECT ?, ifnull(max(last_commit), 0) FROM generations WHERE true "
       "ON CONFLICT (id) DO NOTHING RETURNING last_commit"},
      {&prune_generations_,
       "DELETE FROM generations WHERE seq <= "
       "(SELECT seq FROM generations ORDER BY seq DESC LIMIT 1 OFFSET ?)"},
      {&count_commit_,
       "UPDATE generations SET last_commit = last_commit + 1 "
       "WHERE seq = (SELECT max(seq) FROM generations) RETURNING last_commit"},
  };
  for (const auto& [statement, sql] : statements) {
    RIPS_ASSIGN_OR_RETURN(*statement, db_.Prepare(sql));
  }
  return absl::OkStatus();
}

absl::Status SqliteWriter::InTransaction(const std::function<absl::Status()>& work) {
  RIPS_RETURN_IF_ERROR(begin_.Start().Run());
  absl::Status status = work();
  if (status.ok()) {
    status = commit_.Start().Run();
    // The log may hold all of it, though it was not synced: a restart would find it.
    if (absl::IsUnavailable(status)) {
      status = absl::UnknownError(
          absl::StrCat(status.message(), "; it is not known whether it was written"));
    }
  }
  // After some errors SQLite has rolled back by itself; then this fails and nothing is left to do.
  if (!status.ok()) rollback_.Start().Run().IgnoreError();
  return status;
}

absl::StatusOr<std::vector<uint64_t>> SqliteWriter::Acquire(std::span<const std::string> robots) {
  std::vector<uint64_t> tenures;
  const absl::Status status = InTransaction([&]() -> absl::Status {
    tenures.clear();
    for (const std::string& robot : robots) {
      RIPS_RETURN_IF_ERROR(add_robot_.Start().Bind(robot).Run());
      Query query = acquire_.Start();
      query.Bind(robot);
      RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
      if (!row) return absl::InternalError("the tenure was not updated");
      tenures.push_back(query.Unsigned(0));
      // A statement with RETURNING has to be run to its end.
      RIPS_RETURN_IF_ERROR(query.Run());
    }
    return absl::OkStatus();
  });
  RIPS_RETURN_IF_ERROR(status);
  return tenures;
}

absl::Status SqliteWriter::CheckTenure(absl::string_view robot, uint64_t tenure) {
  Query query = tenure_.Start();
  query.Bind(robot);
  RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
  const uint64_t stored = row ? query.Unsigned(0) : 0;
  if (tenure != 0 && tenure == stored) return absl::OkStatus();
  return Fenced(robot, tenure, stored);
}

absl::StatusOr<uint64_t> SqliteWriter::NextTerm(absl::string_view robot, uint64_t tenure,
                                                uint64_t above) {
  uint64_t term = 0;
  const absl::Status status = InTransaction([&]() -> absl::Status {
    RIPS_RETURN_IF_ERROR(CheckTenure(robot, tenure));
    Query query = next_term_.Start();
    query.Bind(robot).Bind(std::min(above, kTermAboveMax));
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return absl::InternalError("the term was not updated");
    term = query.Unsigned(0);
    // A statement with RETURNING has to be run to its end.
    return query.Run();
  });
  RIPS_RETURN_IF_ERROR(status);
  return term;
}

absl::StatusOr<std::vector<absl::Status>> SqliteWriter::CommitAll(
    std::span<const WriteBatch> batches) {
  std::vector<absl::Status> statuses;
  uint64_t commit = newest_commit_;
  RIPS_RETURN_IF_ERROR(InTransaction([&]() -> absl::Status {
    bool written = false;
    for (const WriteBatch& batch : batches) {
      statuses.push_back(WriteWhole(batch));
      const absl::Status& status = statuses.back();
      if (!status.ok() && !IsOfBatch(status)) return status;
      written |= status.ok();
    }
    if (written) {
      RIPS_ASSIGN_OR_RETURN(commit, CountCommit());
    }
    return absl::OkStatus();
  }));
  newest_commit_ = commit;
  return statuses;
}

absl::Status SqliteWriter::WriteWhole(const WriteBatch& batch) {
  RIPS_RETURN_IF_ERROR(Validate(batch));
  if (batch.tenure != 0) RIPS_RETURN_IF_ERROR(CheckTenure(batch.robot, batch.tenure));
  RIPS_RETURN_IF_ERROR(begin_batch_.Start().Run());
  const absl::Status status = Write(batch);
  if (!status.ok()) {
    if (!IsOfBatch(status)) return status;
    RIPS_RETURN_IF_ERROR(rollback_batch_.Start().Run());
  }
  RIPS_RETURN_IF_ERROR(end_batch_.Start().Run());
  return status;
}

absl::StatusOr<uint64_t> SqliteWriter::CountCommit() {
  Query query = count_commit_.Start();
  RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
  if (!row) return 0;  // no generation was begun
  const uint64_t commit = query.Unsigned(0);
  // A statement with RETURNING has to be run to its end.
  RIPS_RETURN_IF_ERROR(query.Run());
  return commit;
}

absl::Status SqliteWriter::BeginGeneration(absl::string_view id) {
  RIPS_RETURN_IF_ERROR(CheckGeneration(id));
  // A query views what is bound.
  const std::string hex = absl::BytesToHexString(id);
  uint64_t commit = 0;
  const absl::Status status = InTransaction([&]() -> absl::Status {
    {
      Query query = add_generation_.Start();
      query.Bind(hex);
      RIPS_ASSIGN_OR_RETURN(const bool added, query.Step());
      if (!added) return absl::AlreadyExistsError("the store has this generation");
      commit = query.Unsigned(0);
      RIPS_RETURN_IF_ERROR(query.Run());
    }
    return prune_generations_.Start().Bind(uint64_t{kGenerationsMax}).Run();
  });
  if (status.ok()) newest_commit_ = commit;
  return status;
}

absl::Status SqliteWriter::Write(const WriteBatch& batch) {
  const std::string& robot = batch.robot;
  for (const DecisionRecord& each : batch.decisions) RIPS_RETURN_IF_ERROR(Write(robot, each));
  for (const RefusalRecord& each : batch.refusals) RIPS_RETURN_IF_ERROR(Write(robot, each));
  if (!batch.refusals.empty()) {
    RIPS_RETURN_IF_ERROR(prune_refusals_.Start().Bind(limits_.refusals_max).Run());
  }
  for (const StageUpdate& each : batch.stages) {
    RIPS_RETURN_IF_ERROR(set_stage_.Start()
                             .Bind(robot)
                             .Bind(each.decision_id.term)
                             .Bind(each.decision_id.epoch)
                             .Bind(each.stage)
                             .Bind(each.detail)
                             .Run());
  }
  for (const AlertRecord& each : batch.alerts) {
    const std::string trace = TraceToBytes(each.trace);
    RIPS_RETURN_IF_ERROR(add_alert_.Start()
                             .Bind(each.id)
                             .Bind(each.time_unix_ns)
                             .Bind(each.robot)
                             .Bind(each.rule)
                             .Bind(each.severity)
                             .Bind(each.text)
                             .Bind(each.level)
                             .Bind(each.event)
                             .Bind(each.decision_id.term)
                             .Bind(each.decision_id.epoch)
                             .BindBytes(trace)
                             .Bind(each.maintenance)
                             .Run());
  }
  if (!batch.alerts.empty()) RIPS_RETURN_IF_ERROR(PruneAlerts(robot, batch.alerts.size()));
  for (const ReceiptRecord& each : batch.receipts) RIPS_RETURN_IF_ERROR(Write(robot, each));
  if (!batch.receipts.empty()) {
    RIPS_RETURN_IF_ERROR(
        prune_receipts_.Start().Bind(robot).Bind(uint64_t{kReceiptsPerRobotMax}).Run());
  }
  for (const AckRecord& each : batch.acks) RIPS_RETURN_IF_ERROR(Write(each));
  return batch.checkpoint.empty() ? absl::OkStatus() : Write(robot, batch.checkpoint);
}

absl::StatusOr<bool> SqliteWriter::IsStored(const std::string& robot,
                                            const DecisionRecord& decision) {
  Query query = find_decision_.Start();
  query.Bind(decision.id)
      .Bind(robot)
      .Bind(decision.decision_id.term)
      .Bind(decision.decision_id.epoch);
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return false;
    const DecisionRecord stored = {.id = query.Text(0),
                                   .decision_id = {query.Unsigned(8), query.Unsigned(9)},
                                   .based_on = {query.Unsigned(10), query.Unsigned(11)},
                                   .from = query.Text(3),
                                   .to = query.Text(4),
                                   .cause = query.Text(5),
                                   .reason = query.Text(6),
                                   .time_unix_ns = query.Number(2),
                                   .trace = decision.trace};
    if (query.Number(7) != 0 || query.Text(1) != robot || stored != decision) {
      return absl::AlreadyExistsError(absl::StrCat("decision ", ToString(decision.decision_id),
                                                   " or its id names another decision of robot ",
                                                   robot));
    }
    return true;
  }
}

absl::Status SqliteWriter::Write(const std::string& robot, const DecisionRecord& decision) {
  RIPS_ASSIGN_OR_RETURN(const bool stored, IsStored(robot, decision));
  if (stored) return absl::OkStatus();
  // A query views what is bound.
  const std::string trace = TraceToBytes(decision.trace);
  RIPS_RETURN_IF_ERROR(add_decision_.Start()
                           .Bind(decision.id)
                           .Bind(robot)
                           .Bind(decision.time_unix_ns)
                           .Bind(decision.from)
                           .Bind(decision.to)
                           .Bind(decision.cause)
                           .Bind(decision.reason)
                           .Bind(decision.decision_id.term)
                           .Bind(decision.decision_id.epoch)
                           .Bind(decision.based_on.term)
                           .Bind(decision.based_on.epoch)
                           .BindBytes(trace)
                           .Run());
  return apply_decision_.Start()
      .Bind(robot)
      .Bind(decision.decision_id.term)
      .Bind(decision.decision_id.epoch)
      .Bind(decision.to)
      .Run();
}

absl::Status SqliteWriter::Write(const std::string& robot, const RefusalRecord& refusal) {
  const std::string trace = TraceToBytes(refusal.trace);
  Query query = put_refusal_.Start();
  query.Bind(refusal.id)
      .Bind(robot)
      .Bind(refusal.time_unix_ns)
      .Bind(refusal.from)
      .Bind(refusal.to)
      .Bind(refusal.cause)
      .Bind(refusal.reason)
      .Bind(refusal.count)
      .BindBytes(trace);
  RIPS_ASSIGN_OR_RETURN(const bool written, query.Step());
  if (!written) return absl::AlreadyExistsError("the id of a refusal names another transition");
  return query.Run();
}

absl::Status SqliteWriter::Write(const std::string& robot, const ReceiptRecord& receipt) {
  // A query views what is bound.
  const std::string bytes = model_proto::Encode(receipt.receipt).SerializeAsString();
  return put_receipt_.Start()
      .Bind(robot)
      .Bind(receipt.host)
      .Bind(receipt.receipt.command_id)
      .Bind(receipt.command)
      .Bind(receipt.unix_ns)
      .BindBytes(bytes)
      .Run();
}

absl::Status SqliteWriter::Write(const AckRecord& record) {
  const Ack& ack = record.ack;
  Query add = add_ack_.Start();
  add.Bind(record.alert_id).Bind(ack.by).Bind(ack.note).Bind(ack.time_unix_ns);
  RIPS_ASSIGN_OR_RETURN(const bool added, add.Step());
  // A statement with RETURNING has to be run to its end.
  if (added) return add.Run();
  Query find = find_alert_.Start();
  find.Bind(record.alert_id);
  RIPS_ASSIGN_OR_RETURN(const bool kept, find.Step());
  return kept ? absl::OkStatus() : NoSuchAlert(record.alert_id);
}

absl::Status SqliteWriter::PruneAlerts(const std::string& robot, size_t added) {
  const auto [it, first] = unpruned_.try_emplace(robot);
  it->second += static_cast<int64_t>(added);
  if (!first && it->second <= limits_.alerts_per_robot_max / 16) return absl::OkStatus();
  it->second = 0;
  int64_t last = 0;
  {
    Query query = find_prune_.Start();
    query.Bind(robot).Bind(limits_.alerts_per_robot_max);
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return absl::OkStatus();
    last = query.Number(0);
  }
  RIPS_RETURN_IF_ERROR(add_robot_.Start().Bind(robot).Run());
  RIPS_RETURN_IF_ERROR(prune_alerts_.Start()
                           .Bind(robot)
                           .Bind(last)
                           .Bind(limits_.alerts_per_robot_max / kGraveShare)
                           .Run());
  return note_prune_.Start().Bind(robot).Bind(last).Run();
}

absl::Status SqliteWriter::SetNote(absl::string_view name, absl::string_view value) {
  return InTransaction([&] { return set_note_.Start().Bind(name).Bind(value).Run(); });
}

absl::Status SqliteWriter::Write(const std::string& robot, const Checkpoint& checkpoint) {
  if (checkpoint.variables.has_value()) {
    RIPS_RETURN_IF_ERROR(WriteVariables(robot, *checkpoint.variables));
  }
  if (checkpoint.soft_suspended.has_value()) {
    const int64_t suspended = *checkpoint.soft_suspended ? 1 : 0;
    RIPS_RETURN_IF_ERROR(set_suspended_.Start().Bind(robot).Bind(suspended).Run());
  }
  if (checkpoint.rules_halted.has_value()) {
    const int64_t halted = *checkpoint.rules_halted ? 1 : 0;
    RIPS_RETURN_IF_ERROR(set_halted_.Start().Bind(robot).Bind(halted).Run());
  }
  if (checkpoint.resumed_at.has_value()) {
    RIPS_RETURN_IF_ERROR(set_resumed_.Start()
                             .Bind(robot)
                             .Bind(checkpoint.resumed_at->term)
                             .Bind(checkpoint.resumed_at->epoch)
                             .Run());
  }
  if (checkpoint.bundle.has_value()) {
    RIPS_RETURN_IF_ERROR(set_bundle_.Start().Bind(robot).Bind(*checkpoint.bundle).Run());
  }
  if (checkpoint.maintenance.has_value()) {
    const Maintenance& maintenance = *checkpoint.maintenance;
    RIPS_RETURN_IF_ERROR(maintenance.none() ? end_maintenance_.Start().Bind(robot).Run()
                                            : put_maintenance_.Start()
                                                  .Bind(robot)
                                                  .Bind(maintenance.began_unix_ns)
                                                  .Bind(maintenance.until_unix_ns)
                                                  .Bind(maintenance.by)
                                                  .Bind(maintenance.reason)
                                                  .Run());
  }
  for (const auto& [key, sequence] : checkpoint.high_water) {
    RIPS_RETURN_IF_ERROR(put_high_water_.Start()
                             .Bind(robot)
                             .Bind(key.host)
                             .Bind(key.incarnation)
                             .Bind(static_cast<int64_t>(key.lane))
                             .Bind(sequence)
                             .Run());
    RIPS_RETURN_IF_ERROR(prune_high_water_.Start()
                             .Bind(robot)
                             .Bind(key.host)
                             .Bind(uint64_t{kHighWaterPerHostMax})
                             .Run());
  }
  return absl::OkStatus();
}

absl::Status SqliteWriter::WriteVariables(const std::string& robot, const Variables& variables) {
  RIPS_RETURN_IF_ERROR(clear_variables_.Start().Bind(robot).Run());
  for (const auto& [name, value] : variables) {
    int64_t number = 0;
    absl::string_view text;
    if (const int64_t* integer = std::get_if<int64_t>(&value)) number = *integer;
    // The bits, because SQLite turns a NaN into NULL.
    if (const double* real = std::get_if<double>(&value)) number = std::bit_cast<int64_t>(*real);
    if (const bool* truth = std::get_if<bool>(&value)) number = *truth ? 1 : 0;
    if (const std::string* string = std::get_if<std::string>(&value)) text = *string;
    RIPS_RETURN_IF_ERROR(add_variable_.Start()
                             .Bind(robot)
                             .Bind(name)
                             .Bind(static_cast<int64_t>(value.index()))
                             .Bind(number)
                             .Bind(text)
                             .Run());
  }
  return absl::OkStatus();
}

absl::Status SqliteWriter::PutBan(const BanRecord& ban) {
  if (ban.uri.empty()) return absl::InvalidArgumentError("a ban needs a URI");
  return InTransaction([&] {
    return put_ban_.Start()
        .Bind(ban.uri)
        .Bind(ban.serial)
        .Bind(ban.reason)
        .Bind(ban.by)
        .Bind(ban.time_unix_ns)
        .Run();
  });
}

absl::StatusOr<bool> SqliteWriter::RemoveBan(absl::string_view uri, absl::string_view serial) {
  bool removed = false;
  RIPS_RETURN_IF_ERROR(InTransaction([&]() -> absl::Status {
    Query query = remove_ban_.Start();
    query.Bind(uri).Bind(serial);
    RIPS_ASSIGN_OR_RETURN(removed, query.Step());
    // A statement with RETURNING has to be run to its end.
    return removed ? query.Run() : absl::OkStatus();
  }));
  return removed;
}

}  // namespace rips::store
