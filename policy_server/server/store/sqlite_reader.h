// The reading side of SqliteStore. Internal to this folder. One thread at a time.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_READER_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_READER_H_

#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "policy_server/server/store/ack_store.h"
#include "policy_server/server/store/ban_store.h"
#include "policy_server/server/store/sqlite_db.h"
#include "policy_server/server/store/store.h"

namespace rips::store {

class SqliteReader {
 public:
  // The file must be in WAL mode already.
  static absl::StatusOr<SqliteReader> Create(const std::string& path);

  absl::StatusOr<RobotRecord> Load(absl::string_view robot);
  absl::StatusOr<std::optional<std::string>> FindDecision(absl::string_view robot,
                                                          const DecisionId& decision_id);
  absl::StatusOr<std::vector<Generation>> Generations();
  absl::StatusOr<std::vector<TransitionRecord>> ListTransitions(absl::string_view robot,
                                                                uint32_t limit);
  absl::StatusOr<std::vector<AlertRecord>> ListAlerts(absl::string_view robot, uint32_t limit);
  absl::StatusOr<AlertPage> AlertsAfter(absl::string_view robot, uint64_t sequence, uint32_t limit);
  absl::StatusOr<FoundRecords> FindRecords(absl::string_view prefix);
  absl::StatusOr<uint64_t> FindAlert(absl::string_view id);
  absl::StatusOr<std::vector<ReceiptRecord>> ListReceipts(absl::string_view robot, uint32_t limit);
  absl::StatusOr<AlertRecord> NewestAlert();
  absl::StatusOr<std::string> Note(absl::string_view name);
  absl::StatusOr<std::vector<BanRecord>> ListBans();
  absl::StatusOr<std::vector<AckRecord>> FindAcks(std::span<const std::string> alert_ids);
  absl::StatusOr<AlertList> SearchAlerts(const AlertQuery& query);

 private:
  explicit SqliteReader(Database db) : db_(std::move(db)) {}

  absl::Status LoadVariables(absl::string_view robot, Variables* variables);
  absl::Status LoadHighWater(absl::string_view robot, HighWater* high_water);
  absl::Status LoadRuleDecisions(absl::string_view robot, RobotRecord* record);

  // Of all robots, of all those of severity high and critical, or of one robot; of all alerts or of
  // open ones.
  enum From { kFromAll, kFromGrave, kFromOne };
  struct Search {
    Statement alerts;
    // The sequence of the newest alert that is too old to be looked at.
    Statement too_old;
  };
  absl::Status PrepareSearches();

  Database db_;
  Statement begin_, end_;
  Statement robot_, variables_, high_water_, decision_id_, transitions_, alerts_, robot_alerts_,
      bans_, ack_;
  Statement alerts_after_, robot_alerts_after_, forgotten_, robot_forgotten_, find_alert_,
      newest_alert_, note_, receipts_, rule_decisions_, generations_, maintenance_, alerts_by_id_,
      transitions_by_id_;
  Search searches_[3][2];
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_READER_H_
