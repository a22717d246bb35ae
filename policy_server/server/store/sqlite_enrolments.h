// EnrolmentStore in an SQLite file of its own: what happens here holds up no decision.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_ENROLMENTS_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_ENROLMENTS_H_

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/store/enrolment_store.h"
#include "policy_server/server/store/sqlite_db.h"
#include "services/runtime/mutex.h"

namespace rips::store {

class SqliteEnrolments final : public EnrolmentStore {
 public:
  // `path` is made, mode 0600, if it does not exist; its directory must. FailedPrecondition if a
  // newer program wrote it, DataLoss if it is not such a file.
  static absl::StatusOr<std::unique_ptr<SqliteEnrolments>> Open(const std::string& path);

  absl::Status PutToken(const TokenRecord& token) override ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<TokenRecord> FindToken(absl::string_view id) override ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status RevokeToken(absl::string_view id) override ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<std::vector<TokenRecord>> ListTokens() override ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status PutIssued(const IssuedRecord& issued) override ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<IssuedRecord> FindIssued(absl::string_view token, absl::string_view uri) override
      ABSL_LOCKS_EXCLUDED(mu_);
  absl::StatusOr<std::vector<IssuedRecord>> ListIssued(absl::string_view uri) override
      ABSL_LOCKS_EXCLUDED(mu_);

 private:
  explicit SqliteEnrolments(Database db) : db_(std::move(db)) {}

  absl::Status PrepareAll();
  // `work` inside BEGIN IMMEDIATE and COMMIT; rolled back if either fails.
  absl::Status InTransaction(const std::function<absl::Status()>& work)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  absl::StatusOr<TokenRecord> Find(absl::string_view id) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);
  // FailedPrecondition or AlreadyExists if its token gave this identity's certificate to a key.
  absl::Status CheckUnused(const IssuedRecord& issued) ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_);

  Mutex mu_;
  Database db_ ABSL_GUARDED_BY(mu_);
  Statement put_token_ ABSL_GUARDED_BY(mu_);
  Statement prune_tokens_ ABSL_GUARDED_BY(mu_);
  Statement find_token_ ABSL_GUARDED_BY(mu_);
  Statement revoke_token_ ABSL_GUARDED_BY(mu_);
  Statement list_tokens_ ABSL_GUARDED_BY(mu_);
  Statement find_issued_ ABSL_GUARDED_BY(mu_);
  Statement count_good_ ABSL_GUARDED_BY(mu_);
  Statement put_issued_ ABSL_GUARDED_BY(mu_);
  Statement prune_issued_ ABSL_GUARDED_BY(mu_);
  Statement list_issued_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_ENROLMENTS_H_
