// Store in one SQLite file (WAL, synchronous=FULL): the embedded default.
//
// Two connections: writes wait for the disk, reads do not wait for writes. One process at a time
// uses the file. A damaged or empty file is DataLoss at Open and is left as it is: starting anew
// would forget every level, and that is for the operator to decide.
#ifndef RIPS_POLICY_SERVER_STORE_SQLITE_STORE_H_
#define RIPS_POLICY_SERVER_STORE_SQLITE_STORE_H_

#include <memory>
#include <string>
#include <vector>

#include "policy_server/store/store.h"

namespace rips::store {

struct SqliteLimits {
  // The newest so many alerts are kept; older ones go with a later commit.
  int64_t alerts_max = 1'000'000;
  // Refusals among the newest so many transitions are kept. Decisions are kept for ever: they are
  // the history against which a robot's mark is checked.
  int64_t refusals_max = 100'000;
};

class SqliteStore final : public Store {
 public:
  // `path` is made if it does not exist; its directory must exist. Errors: see the port, and
  // FailedPrecondition if another process uses the file or a newer program wrote it.
  static absl::StatusOr<std::unique_ptr<SqliteStore>> Open(const std::string& path,
                                                           SqliteLimits limits = {});
  ~SqliteStore() override;

  using Store::NextTerm;
  absl::StatusOr<RobotRecord> Load(absl::string_view robot) override;
  absl::StatusOr<uint64_t> NextTerm(absl::string_view robot, uint64_t above) override;
  absl::StatusOr<bool> HasMark(absl::string_view robot, const Mark& mark) override;
  absl::Status CommitAll(std::span<const WriteBatch> batches) override;
  absl::StatusOr<std::vector<TransitionRecord>> ListTransitions(absl::string_view robot,
                                                                uint32_t limit) override;
  absl::StatusOr<std::vector<AlertRecord>> ListAlerts(absl::string_view robot,
                                                      uint32_t limit) override;

 private:
  struct Parts;
  explicit SqliteStore(std::unique_ptr<Parts> parts);

  std::unique_ptr<Parts> parts_;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_STORE_SQLITE_STORE_H_
