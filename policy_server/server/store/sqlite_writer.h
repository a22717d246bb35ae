// The writing side of SqliteStore: what a batch does to the tables. Internal to this folder.
// One thread at a time.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_WRITER_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_WRITER_H_

#include <functional>
#include <span>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "policy_server/server/store/ban_store.h"
#include "policy_server/server/store/sqlite_db.h"
#include "policy_server/server/store/sqlite_store.h"
#include "policy_server/server/store/store.h"

namespace rips::store {

class SqliteWriter {
 public:
  static absl::StatusOr<SqliteWriter> Create(const std::string& path, SqliteLimits limits);

  // The tenures drawn, in the order of the robots.
  absl::StatusOr<std::vector<uint64_t>> Acquire(std::span<const std::string> robots);
  absl::StatusOr<uint64_t> NextTerm(absl::string_view robot, uint64_t tenure, uint64_t above);
  absl::Status BeginGeneration(absl::string_view id);
  absl::StatusOr<std::vector<absl::Status>> CommitAll(std::span<const WriteBatch> batches);
  // The newest that is durable.
  uint64_t newest_commit() const { return newest_commit_; }
  absl::Status SetNote(absl::string_view name, absl::string_view value);
  absl::Status PutBan(const BanRecord& ban);
  absl::StatusOr<bool> RemoveBan(absl::string_view uri, absl::string_view serial);

 private:
  SqliteWriter(Database db, SqliteLimits limits) : db_(std::move(db)), limits_(limits) {}

  absl::Status PrepareAll();
  // `work` inside BEGIN IMMEDIATE and COMMIT; rolled back if either fails.
  absl::Status InTransaction(const std::function<absl::Status()>& work);
  // The number of the commit that is being made.
  absl::StatusOr<uint64_t> CountCommit();
  // Inside the transaction, all of the batch or nothing of it.
  absl::Status WriteWhole(const WriteBatch& batch);
  absl::Status Write(const WriteBatch& batch);
  // Aborted unless the robot's tenure is `tenure`.
  absl::Status CheckTenure(absl::string_view robot, uint64_t tenure);
  absl::Status Write(const std::string& robot, const DecisionRecord& decision);
  absl::Status Write(const std::string& robot, const RefusalRecord& refusal);
  absl::Status Write(const std::string& robot, const ReceiptRecord& receipt);
  absl::Status Write(const AckRecord& record);
  absl::Status Write(const std::string& robot, const Checkpoint& checkpoint);
  // Forgets the oldest alerts of a robot that has more than its share, when so many were `added`.
  absl::Status PruneAlerts(const std::string& robot, size_t added);
  absl::Status WriteVariables(const std::string& robot, const Variables& variables);
  // True if exactly this decision is stored; AlreadyExists if another has its decision id or id.
  absl::StatusOr<bool> IsStored(const std::string& robot, const DecisionRecord& decision);

  Database db_;
  SqliteLimits limits_;
  // Alerts of a robot since the last attempt to prune them, which costs as much as the limit.
  absl::btree_map<std::string, int64_t> unpruned_;
  Statement begin_, commit_, rollback_, begin_batch_, rollback_batch_, end_batch_;
  Statement add_robot_, acquire_, tenure_, next_term_, find_decision_, add_decision_,
      apply_decision_;
  Statement put_receipt_, prune_receipts_;
  Statement put_refusal_, prune_refusals_, set_stage_, add_alert_, find_prune_, prune_alerts_,
      note_prune_, set_note_, set_bundle_;
  Statement clear_variables_, add_variable_, set_suspended_, set_halted_, set_resumed_,
      put_high_water_, prune_high_water_, put_maintenance_, end_maintenance_;
  Statement put_ban_, remove_ban_, add_ack_, find_alert_;
  Statement add_generation_, prune_generations_, count_commit_;
  uint64_t newest_commit_ = 0;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_WRITER_H_
