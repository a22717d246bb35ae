#include "policy_server/server/store/sqlite_reader.h"

#include <algorithm>
#include <bit>
#include <limits>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/server/store/trace_codec.h"
#include "services/base/status_macros.h"
#include "services/model_proto/actuator_codec.h"

namespace rips::store {
namespace {

// The inverse of how SqliteWriter writes a value.
absl::StatusOr<lang::Value> ToValue(int64_t kind, int64_t number, std::string text) {
  switch (kind) {
    case 0:
      return lang::Value(number);
    case 1:
      return lang::Value(std::bit_cast<double>(number));
    case 2:
      return lang::Value(number != 0);
    case 3:
      return lang::Value(std::move(text));
    default:
      return absl::DataLossError(absl::StrCat("variable of unknown kind ", kind));
  }
}

AlertRecord ReadAlert(const Query& query) {
  return {.id = query.Text(0),
          .time_unix_ns = query.Number(1),
          .robot = query.Text(2),
          .rule = query.Text(3),
          .severity = query.Text(4),
          .text = query.Text(5),
          .level = query.Text(6),
          .event = query.Text(7),
          .decision_id = {query.Unsigned(8), query.Unsigned(9)},
          .maintenance = query.Text(11),
          .trace = TraceFromBytes(query.Text(10))};
}

// Of the row that is next; none if there is no row.
absl::StatusOr<Maintenance> ReadMaintenance(Query& query) {
  RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
  if (!row) return Maintenance();
  return Maintenance{.began_unix_ns = query.Number(0),
                     .until_unix_ns = query.Number(1),
                     .by = query.Text(2),
                     .reason = query.Text(3)};
}

TransitionRecord ReadTransition(const Query& query) {
  return {.id = query.Text(0),
          .robot = query.Text(1),
          .time_unix_ns = query.Number(2),
          .from = query.Text(3),
          .to = query.Text(4),
          .cause = query.Text(5),
          .reason = query.Text(6),
          .decision_id = {query.Unsigned(8), query.Unsigned(9)},
          .based_on = {query.Unsigned(10), query.Unsigned(11)},
          .refused = query.Number(7) != 0,
          .count = query.Unsigned(12),
          .stage = query.Text(13),
          .detail = query.Text(14),
          .trace = TraceFromBytes(query.Text(15))};
}

}  // namespace

absl::StatusOr<SqliteReader> SqliteReader::Create(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(Database db, Database::Open(path, Database::Mode::kReadOnly));
  SqliteReader reader(std::move(db));
  const std::pair<Statement*, const char*> statements[] = {
      {&reader.begin_, "BEGIN"},
      {&reader.end_, "ROLLBACK"},
      {&reader.robot_,
       "SELECT level, term, epoch, highest_term, soft_suspended, rules_halted, bundle,"
       " resumed_term, resumed_epoch "
       "FROM robots WHERE robot = ?"},
      {&reader.variables_, "SELECT name, kind, number, text FROM variables WHERE robot = ?"},
      {&reader.high_water_,
       "SELECT host, incarnation, lane, sequence FROM high_water WHERE robot = ?"},
      {&reader.maintenance_,
       "SELECT began_unix_ns, until_unix_ns, by, reason FROM maintenance WHERE robot = ?"},
      // Those of rules, newest first.
      {&reader.rule_decisions_,
       "SELECT term, epoch, from_level, to_level, time_unix_ns FROM transitions "
       "WHERE robot = ? AND refused = 0 AND cause GLOB 'rule *' AND (term, epoch) > (?, ?) "
       "ORDER BY term DESC, epoch DESC LIMIT ?"},
      {&reader.generations_, "SELECT id, last_commit FROM generations ORDER BY seq"},
      {&reader.decision_id_,
       "SELECT to_level FROM transitions "
       "WHERE robot = ? AND term = ? AND epoch = ? AND refused = 0"},
      {&reader.transitions_,
       "SELECT id, robot, time_unix_ns, from_level, to_level, cause, reason, refused, term, epoch,"
       " based_term, based_epoch, count, stage, detail, trace FROM transitions "
       "WHERE robot = ? ORDER BY seq DESC LIMIT ?"},
      {&reader.transitions_by_id_,
       "SELECT id, robot, time_unix_ns, from_level, to_level, cause, reason, refused, term, epoch,"
       " based_term, based_epoch, count, stage, detail, trace FROM transitions "
       "WHERE id >= ? AND id < ? ORDER BY id LIMIT 2"},
      {&reader.alerts_by_id_,
       "SELECT id, time_unix_ns, robot, rule, severity, text, level, event, term, epoch, trace,"
       " maintenance "
       "FROM alerts WHERE id >= ? AND id < ? ORDER BY id LIMIT 2"},
      {&reader.alerts_,
       "SELECT id, time_unix_ns, robot, rule, severity, text, level, event, term, epoch, trace,"
       " maintenance "
       "FROM alerts ORDER BY seq DESC LIMIT ?"},
      {&reader.robot_alerts_,
       "SELECT id, time_unix_ns, robot, rule, severity, text, level, event, term, epoch, trace,"
       " maintenance "
       "FROM alerts WHERE robot = ? ORDER BY seq DESC LIMIT ?"},
      {&reader.alerts_after_,
       "SELECT id, time_unix_ns, robot, rule, severity, text, level, event, term, epoch, trace,"
       " maintenance, seq "
       "FROM alerts WHERE seq > ? ORDER BY seq LIMIT ?"},
      {&reader.robot_alerts_after_,
       "SELECT id, time_unix_ns, robot, rule, severity, text, level, event, term, epoch, trace,"
       " maintenance, seq "
       "FROM alerts WHERE robot = ? AND seq > ? ORDER BY seq LIMIT ?"},
      {&reader.forgotten_, "SELECT ifnull(max(alerts_forgotten), 0) FROM robots"},
      {&reader.robot_forgotten_,
       "SELECT ifnull(max(alerts_forgotten), 0) FROM robots WHERE robot = ?"},
      {&reader.find_alert_, "SELECT seq FROM alerts WHERE id = ?"},
      {&reader.newest_alert_, "SELECT id, seq FROM alerts ORDER BY seq DESC LIMIT 1"},
      {&reader.receipts_,
       "SELECT time_unix_ns, host, command, receipt FROM receipts WHERE robot = ? "
       "ORDER BY seq DESC LIMIT ?"},
      {&reader.note_, "SELECT value FROM notes WHERE name = ?"},
      {&reader.bans_,
       "SELECT uri, serial, reason, by, time_unix_ns FROM bans ORDER BY uri, serial"},
      {&reader.ack_,
       "SELECT ack_by, ack_note, ack_unix_ns FROM alerts WHERE id = ? AND ack_unix_ns > 0"},
  };
  for (const auto& [statement, sql] : statements) {
    RIPS_ASSIGN_OR_RETURN(*statement, reader.db_.Prepare(sql));
  }
  RIPS_RETURN_IF_ERROR(reader.PrepareSearches());
  return reader;
}

// However many of the newest are acknowledged, a search for open ones reads none of them.
absl::Status SqliteReader::PrepareSearches() {
  constexpr absl::string_view kFrom[3][2] = {
      {"FROM alerts WHERE ?1 = ''",
       "FROM alerts INDEXED BY alerts_open WHERE ?1 = '' AND "
       "ack_unix_ns = 0"},
      // However many of less severity came later.
      {"FROM alerts INDEXED BY alerts_grave WHERE ?1 = '' AND severity IN ('high', 'critical')",
       "FROM alerts INDEXED BY alerts_grave WHERE ?1 = '' AND severity IN ('high', 'critical') AND "
       "ack_unix_ns = 0"},
      {"FROM alerts INDEXED BY alerts_robot WHERE robot = ?1",
       "FROM alerts INDEXED BY alerts_robot_open WHERE robot = ?1 AND ack_unix_ns = 0"}};
  for (const int which : {kFromAll, kFromGrave, kFromOne}) {
    for (const bool open : {false, true}) {
      Search& search = searches_[which][open];
      const absl::string_view from = kFrom[which][open];
      RIPS_ASSIGN_OR_RETURN(
          search.alerts,
          db_.Prepare(absl::StrCat(
              "SELECT id, time_unix_ns, robot, rule, severity, text, level, event, term, epoch,"
              " trace, maintenance ",
              from,
              " AND seq > ?2 AND (?3 = '' OR instr(?3, ',' || severity || ',') > 0)"
              " AND (?4 = '' OR rule = ?4) AND time_unix_ns >= ?5 ORDER BY seq DESC LIMIT ?6")));
      RIPS_ASSIGN_OR_RETURN(
          search.too_old,
          db_.Prepare(absl::StrCat("SELECT seq ", from, " ORDER BY seq DESC LIMIT 1 OFFSET ?2")));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<RobotRecord> SqliteReader::Load(absl::string_view robot) {
  // One transaction, so that level, variables and sequences are of one moment.
  RIPS_RETURN_IF_ERROR(begin_.Start().Run());
  auto read = [&]() -> absl::StatusOr<RobotRecord> {
    RobotRecord record;
    Query query = robot_.Start();
    query.Bind(robot);
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return record;
    record.level = query.Text(0);
    record.decision_id = {query.Unsigned(1), query.Unsigned(2)};
    record.highest_term = query.Unsigned(3);
    record.soft_suspended = query.Number(4) != 0;
    record.rules_halted = query.Number(5) != 0;
    record.bundle = query.Text(6);
    record.resumed_at = {query.Unsigned(7), query.Unsigned(8)};
    RIPS_RETURN_IF_ERROR(LoadRuleDecisions(robot, &record));
    RIPS_RETURN_IF_ERROR(LoadVariables(robot, &record.variables));
    RIPS_RETURN_IF_ERROR(LoadHighWater(robot, &record.high_water));
    Query maintenance = maintenance_.Start();
    maintenance.Bind(robot);
    RIPS_ASSIGN_OR_RETURN(record.maintenance, ReadMaintenance(maintenance));
    return record;
  };
  absl::StatusOr<RobotRecord> record = read();
  const absl::Status ended = end_.Start().Run();
  if (record.ok() && !ended.ok()) return ended;
  return record;
}

absl::Status SqliteReader::LoadVariables(absl::string_view robot, Variables* variables) {
  Query query = variables_.Start();
  query.Bind(robot);
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return absl::OkStatus();
    RIPS_ASSIGN_OR_RETURN(lang::Value value,
                          ToValue(query.Number(1), query.Number(2), query.Text(3)));
    variables->insert_or_assign(query.Text(0), std::move(value));
  }
}

absl::Status SqliteReader::LoadHighWater(absl::string_view robot, HighWater* high_water) {
  Query query = high_water_.Start();
  query.Bind(robot);
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return absl::OkStatus();
    const int64_t lane = query.Number(2);
    if (lane != 1 && lane != 2) {
      return absl::DataLossError(absl::StrCat("high water of unknown lane ", lane));
    }
    high_water->insert_or_assign({.host = query.Text(0),
                                  .incarnation = query.Text(1),
                                  .lane = static_cast<LaneKey::Lane>(lane)},
                                 query.Unsigned(3));
  }
}

absl::Status SqliteReader::LoadRuleDecisions(absl::string_view robot, RobotRecord* record) {
  Query query = rule_decisions_.Start();
  query.Bind(robot)
      .Bind(record->resumed_at.term)
      .Bind(record->resumed_at.epoch)
      .Bind(uint64_t{kRuleDecisionsMax});
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) break;
    record->rule_decisions.push_back({.decision_id = {query.Unsigned(0), query.Unsigned(1)},
                                      .from = query.Text(2),
                                      .to = query.Text(3),
                                      .time_unix_ns = query.Number(4)});
  }
  std::reverse(record->rule_decisions.begin(), record->rule_decisions.end());
  return absl::OkStatus();
}

absl::StatusOr<std::vector<Generation>> SqliteReader::Generations() {
  std::vector<Generation> out;
  Query query = generations_.Start();
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return out;
    out.push_back({.id = absl::HexStringToBytes(query.Text(0)), .last_commit = query.Unsigned(1)});
  }
}

absl::StatusOr<std::optional<std::string>> SqliteReader::FindDecision(
    absl::string_view robot, const DecisionId& decision_id) {
  // What is above cannot be stored, and would wrap around.
  if (decision_id.none() || decision_id.term > kNumberMax || decision_id.epoch > kNumberMax)
    return std::nullopt;
  Query query = decision_id_.Start();
  query.Bind(robot).Bind(decision_id.term).Bind(decision_id.epoch);
  RIPS_ASSIGN_OR_RETURN(const bool found, query.Step());
  if (!found) return std::nullopt;
  return query.Text(0);
}

absl::StatusOr<std::vector<TransitionRecord>> SqliteReader::ListTransitions(absl::string_view robot,
                                                                            uint32_t limit) {
  std::vector<TransitionRecord> out;
  Query query = transitions_.Start();
  query.Bind(robot).Bind(int64_t{ListLimit(limit)});
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return out;
    out.push_back(ReadTransition(query));
  }
}

absl::StatusOr<std::vector<AlertRecord>> SqliteReader::ListAlerts(absl::string_view robot,
                                                                  uint32_t limit) {
  std::vector<AlertRecord> out;
  Query query = robot.empty() ? alerts_.Start() : robot_alerts_.Start();
  if (!robot.empty()) query.Bind(robot);
  query.Bind(int64_t{ListLimit(limit)});
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return out;
    out.push_back(ReadAlert(query));
  }
}

absl::StatusOr<std::vector<ReceiptRecord>> SqliteReader::ListReceipts(absl::string_view robot,
                                                                      uint32_t limit) {
  std::vector<ReceiptRecord> out;
  Query query = receipts_.Start();
  query.Bind(robot).Bind(int64_t{ListLimit(limit)});
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return out;
    rips::v1::Receipt stored;
    if (!stored.ParseFromString(query.Text(3))) {
      return absl::DataLossError("a receipt that cannot be read");
    }
    RIPS_ASSIGN_OR_RETURN(model::Receipt receipt, model_proto::Decode(stored));
    out.push_back({.unix_ns = query.Number(0),
                   .host = query.Text(1),
                   .command = query.Text(2),
                   .receipt = std::move(receipt)});
  }
}

absl::StatusOr<AlertPage> SqliteReader::AlertsAfter(absl::string_view robot, uint64_t sequence,
                                                    uint32_t limit) {
  // Nothing is stored above it.
  if (sequence > kNumberMax) return AlertPage{};
  // One transaction: what is pruned in between must show.
  RIPS_RETURN_IF_ERROR(begin_.Start().Run());
  auto read = [&]() -> absl::StatusOr<AlertPage> {
    AlertPage page;
    {
      Query query = robot.empty() ? forgotten_.Start() : robot_forgotten_.Start();
      if (!robot.empty()) query.Bind(robot);
      RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
      page.forgotten = row && query.Unsigned(0) > sequence;
    }
    Query query = robot.empty() ? alerts_after_.Start() : robot_alerts_after_.Start();
    if (!robot.empty()) query.Bind(robot);
    query.Bind(sequence).Bind(int64_t{ListLimit(limit)});
    while (true) {
      RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
      if (!row) return page;
      page.alerts.push_back(ReadAlert(query));
      page.alerts.back().sequence = query.Unsigned(12);
    }
  };
  absl::StatusOr<AlertPage> page = read();
  const absl::Status ended = end_.Start().Run();
  if (page.ok() && !ended.ok()) return ended;
  return page;
}

absl::StatusOr<FoundRecords> SqliteReader::FindRecords(absl::string_view prefix) {
  // Above all ids that begin so: ids are hex digits.
  const std::string end = absl::StrCat(prefix, "g");
  FoundRecords found;
  const auto read = [&](const Statement& statement, auto& records,
                        const auto& read_one) -> absl::Status {
    Query query = statement.Start();
    query.Bind(prefix).Bind(end);
    while (true) {
      RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
      if (!row) return absl::OkStatus();
      records.push_back(read_one(query));
    }
  };
  RIPS_RETURN_IF_ERROR(read(alerts_by_id_, found.alerts, ReadAlert));
  RIPS_RETURN_IF_ERROR(read(transitions_by_id_, found.transitions, ReadTransition));
  return found;
}

absl::StatusOr<uint64_t> SqliteReader::FindAlert(absl::string_view id) {
  Query query = find_alert_.Start();
  query.Bind(id);
  RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
  return row ? query.Unsigned(0) : 0;
}

absl::StatusOr<AlertRecord> SqliteReader::NewestAlert() {
  Query query = newest_alert_.Start();
  RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
  AlertRecord newest;
  if (!row) return newest;
  newest.id = query.Text(0);
  newest.sequence = query.Unsigned(1);
  return newest;
}

absl::StatusOr<std::string> SqliteReader::Note(absl::string_view name) {
  Query query = note_.Start();
  query.Bind(name);
  RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
  return row ? query.Text(0) : std::string();
}

absl::StatusOr<std::vector<BanRecord>> SqliteReader::ListBans() {
  std::vector<BanRecord> out;
  Query query = bans_.Start();
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) return out;
    out.push_back({.uri = query.Text(0),
                   .serial = query.Text(1),
                   .reason = query.Text(2),
                   .by = query.Text(3),
                   .time_unix_ns = query.Number(4)});
  }
}

absl::StatusOr<AlertList> SqliteReader::SearchAlerts(const AlertQuery& wanted) {
  const bool grave = !wanted.severities.empty() &&
                     std::all_of(wanted.severities.begin(), wanted.severities.end(),
                                 [](const std::string& severity) {
                                   return severity == "high" || severity == "critical";
                                 });
  const From from = !wanted.robot.empty() ? kFromOne : grave ? kFromGrave : kFromAll;
  const Search& search = searches_[from][wanted.open];
  uint64_t too_old = 0;
  if (wanted.searches()) {
    Query query = search.too_old.Start();
    query.Bind(wanted.robot).Bind(kAlertsSearchedMax);
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (row) too_old = query.Unsigned(0);
  }
  // A query views what is bound.
  const std::string severities =
      wanted.severities.empty() ? ""
                                : absl::StrCat(",", absl::StrJoin(wanted.severities, ","), ",");
  const int64_t limit = ListLimit(wanted.limit);
  AlertList list;
  Query query = search.alerts.Start();
  query.Bind(wanted.robot)
      .Bind(too_old)
      .Bind(severities)
      .Bind(wanted.rule)
      .Bind(wanted.since_unix_ns == 0 ? std::numeric_limits<int64_t>::min() : wanted.since_unix_ns)
      .Bind(limit);
  while (true) {
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) break;
    list.alerts.push_back(ReadAlert(query));
  }
  list.older_not_searched = too_old > 0 && static_cast<int64_t>(list.alerts.size()) < limit;
  return list;
}

absl::StatusOr<std::vector<AckRecord>> SqliteReader::FindAcks(
    std::span<const std::string> alert_ids) {
  std::vector<AckRecord> out;
  for (const std::string& id : alert_ids) {
    Query query = ack_.Start();
    query.Bind(id);
    RIPS_ASSIGN_OR_RETURN(const bool row, query.Step());
    if (!row) continue;
    out.push_back(
        {.alert_id = id,
         .ack = {.by = query.Text(0), .note = query.Text(1), .time_unix_ns = query.Number(2)}});
  }
  return out;
}

}  // namespace rips::store
