// Store in one SQLite file (WAL, synchronous=FULL): the embedded default.
//
// On a full disk decisions alone are still written, into room that a reserve beside the file gives
// up (DiskReserve); everything else is ResourceExhausted until the reserve is whole again.
//
// Two connections: writes wait for the disk, reads do not wait for writes. One process at a time
// uses the file. While it, or its write-ahead log, is not at its place any more, writes are
// Unavailable: they would be gone at the next start. A damaged or empty file is DataLoss at Open
// and is left as it is: starting anew would forget every level; that is for the operator to decide.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_STORE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_STORE_H_

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/server/store/ack_store.h"
#include "policy_server/server/store/ban_store.h"
#include "policy_server/server/store/store.h"

namespace rips::store {

struct SqliteLimits {
  // Of each robot the newest so many alerts are kept, and up to a sixteenth more; older ones go
  // with a later commit. One robot's alerts push out no other's.
  // A tenth as many of severity high and critical are kept beyond that, the newest.
  int64_t alerts_per_robot_max = 10'000;
  // Refusals among the newest so many transitions are kept. Decisions are kept for ever: they are
  // the history against which a robot's decision id is checked.
  int64_t refusals_max = 100'000;
  // Kept free for decisions on a full disk; a decision takes about 50 KiB of it at worst.
  int64_t reserve_bytes = int64_t{16} << 20;
};

class SqliteStore final : public Store, public BanStore, public AckStore {
 public:
  // `path` is made if it does not exist; its directory must exist. Errors: see the port, and
  // FailedPrecondition if another process uses the file or a newer program wrote it.
  static absl::StatusOr<std::unique_ptr<SqliteStore>> Open(const std::string& path,
                                                           SqliteLimits limits = {});
  ~SqliteStore() override;

  using Store::Acquire;
  absl::StatusOr<RobotRecord> Load(absl::string_view robot) override;
  absl::StatusOr<std::vector<Acquired>> Acquire(std::span<const std::string> robots) override;
  absl::StatusOr<uint64_t> NextTerm(absl::string_view robot, uint64_t tenure,
                                    uint64_t above) override;
  absl::StatusOr<std::optional<std::string>> FindDecision(absl::string_view robot,
                                                          const DecisionId& decision_id) override;
  absl::Status BeginGeneration(absl::string_view id) override;
  absl::StatusOr<std::vector<Generation>> Generations() override;
  uint64_t newest_commit() const override;
  absl::StatusOr<std::vector<absl::Status>> CommitAll(std::span<const WriteBatch> batches) override;
  absl::StatusOr<std::vector<TransitionRecord>> ListTransitions(absl::string_view robot,
                                                                uint32_t limit) override;
  absl::StatusOr<std::vector<AlertRecord>> ListAlerts(absl::string_view robot,
                                                      uint32_t limit) override;
  absl::StatusOr<AlertPage> AlertsAfter(absl::string_view robot, uint64_t sequence,
                                        uint32_t limit) override;
  absl::StatusOr<FoundRecords> FindRecords(absl::string_view prefix) override;
  absl::StatusOr<uint64_t> FindAlert(absl::string_view id) override;
  absl::StatusOr<std::vector<ReceiptRecord>> ListReceipts(absl::string_view robot,
                                                          uint32_t limit) override;
  absl::StatusOr<AlertRecord> NewestAlert() override;
  absl::StatusOr<std::string> Note(absl::string_view name) override;
  absl::Status SetNote(absl::string_view name, absl::string_view value) override;
  absl::Status PutBan(const BanRecord& ban) override;
  absl::StatusOr<bool> RemoveBan(absl::string_view uri, absl::string_view serial) override;
  absl::StatusOr<std::vector<BanRecord>> ListBans() override;
  absl::StatusOr<std::vector<AckRecord>> FindAcks(std::span<const std::string> alert_ids) override;
  absl::StatusOr<AlertList> SearchAlerts(const AlertQuery& query) override;

 private:
  struct Parts;
  explicit SqliteStore(std::unique_ptr<Parts> parts);

  std::unique_ptr<Parts> parts_;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_STORE_H_
