// The reading side of SqliteStore. Internal to this folder. One thread at a time.
#ifndef RIPS_POLICY_SERVER_STORE_SQLITE_READER_H_
#define RIPS_POLICY_SERVER_STORE_SQLITE_READER_H_

#include <string>
#include <utility>
#include <vector>

#include "policy_server/store/sqlite_db.h"
#include "policy_server/store/store.h"

namespace rips::store {

class SqliteReader {
 public:
  // The file must be in WAL mode already.
  static absl::StatusOr<SqliteReader> Create(const std::string& path);

  absl::StatusOr<RobotRecord> Load(absl::string_view robot);
  absl::StatusOr<bool> HasMark(absl::string_view robot, const Mark& mark);
  absl::StatusOr<std::vector<TransitionRecord>> ListTransitions(absl::string_view robot,
                                                                uint32_t limit);
  absl::StatusOr<std::vector<AlertRecord>> ListAlerts(absl::string_view robot, uint32_t limit);

 private:
  explicit SqliteReader(Database db) : db_(std::move(db)) {}

  absl::Status LoadVariables(absl::string_view robot, Variables* variables);
  absl::Status LoadHighWater(absl::string_view robot, HighWater* high_water);

  Database db_;
  Statement begin_, end_;
  Statement robot_, variables_, high_water_, mark_, transitions_, alerts_, robot_alerts_;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_STORE_SQLITE_READER_H_
