#include "policy_server/store/sqlite_reader.h"

#include <bit>

#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"

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
          .mark = {query.Unsigned(8), query.Unsigned(9)}};
}

TransitionRecord ReadTransition(const Query& query) {
  return {.id = query.Text(0),
          .robot = query.Text(1),
          .time_unix_ns = query.Number(2),
          .from = query.Text(3),
          .to = query.Text(4),
          .cause = query.Text(5),
          .reason = query.Text(6),
          .mark = {query.Unsigned(8), query.Unsigned(9)},
          .based_on = {query.Unsigned(10), query.Unsigned(11)},
          .refused = query.Number(7) != 0,
          .count = query.Unsigned(12),
          .stage = query.Text(13),
          .detail = query.Text(14)};
}

}  // namespace

absl::StatusOr<SqliteReader> SqliteReader::Create(const std::string& path) {
  RIPS_ASSIGN_OR_RETURN(Database db, Database::Open(path, Database::Mode::kReadOnly));
  SqliteReader reader(std::move(db));
  const std::pair<Statement*, const char*> statements[] = {
      {&reader.begin_, "BEGIN"},
      {&reader.end_, "ROLLBACK"},
      {&reader.robot_,
       "SELECT level, term, epoch, highest_term, soft_suspended, rules_halted "
       "FROM robots WHERE robot = ?"},
      {&reader.variables_, "SELECT name, kind, number, text FROM variables WHERE robot = ?"},
      {&reader.high_water_,
       "SELECT host, incarnation, lane, sequence FROM high_water WHERE robot = ?"},
      {&reader.mark_,
       "SELECT 1 FROM transitions WHERE robot = ? AND term = ? AND epoch = ? AND refused = 0"},
      {&reader.transitions_,
       "SELECT id, robot, time_unix_ns, from_level, to_level, cause, reason, refused, term, epoch,"
       " based_term, based_epoch, count, stage, detail FROM transitions "
       "WHERE robot = ? ORDER BY seq DESC LIMIT ?"},
      {&reader.alerts_,
       "SELECT id, time_unix_ns, robot, rule, severity, text, level, event, term, epoch "
       "FROM alerts ORDER BY seq DESC LIMIT ?"},
      {&reader.robot_alerts_,
       "SELECT id, time_unix_ns, robot, rule, severity, text, level, event, term, epoch "
       "FROM alerts WHERE robot = ? ORDER BY seq DESC LIMIT ?"},
  };
  for (const auto& [statement, sql] : statements) {
    RIPS_ASSIGN_OR_RETURN(*statement, reader.db_.Prepare(sql));
  }
  return reader;
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
    record.mark = {query.Unsigned(1), query.Unsigned(2)};
    record.highest_term = query.Unsigned(3);
    record.soft_suspended = query.Number(4) != 0;
    record.rules_halted = query.Number(5) != 0;
    RIPS_RETURN_IF_ERROR(LoadVariables(robot, &record.variables));
    RIPS_RETURN_IF_ERROR(LoadHighWater(robot, &record.high_water));
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

absl::StatusOr<bool> SqliteReader::HasMark(absl::string_view robot, const Mark& mark) {
  // What is above cannot be stored, and would wrap around.
  if (mark.none() || mark.term > kNumberMax || mark.epoch > kNumberMax) return false;
  Query query = mark_.Start();
  query.Bind(robot).Bind(mark.term).Bind(mark.epoch);
  return query.Step();
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

}  // namespace rips::store
