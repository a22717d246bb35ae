// The state file of the policy server: made once, whole, and never made again in silence.
// Internal to this folder.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_FILE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_FILE_H_

#include <sys/types.h>

#include <optional>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "services/runtime/unique_fd.h"

namespace rips::store {

// Schema version this program reads and writes (`PRAGMA user_version`).
inline constexpr int kSchemaVersion = 10;

// Keeps other processes from using the state file at `path`, through `path`.lock, until it goes.
// FailedPrecondition if another process holds it; Unavailable if it cannot be locked.
absl::StatusOr<UniqueFd> LockStateFile(const std::string& path);

// Makes the file with an empty schema (mode 0600) if there is none, else checks the one there.
// The caller holds the lock. A file is built beside and renamed, so a crash leaves none or a
// whole one.
//   DataLoss: it is empty, damaged, not ours, or gone while its write-ahead log is still there.
//   FailedPrecondition: a newer program wrote it, or the path is not a regular file.
//   Unavailable: it cannot be read or made.
absl::Status PrepareStateFile(const std::string& path);

// The state file and its write-ahead log as they were opened. What is written into files that were
// removed, moved or replaced since, as by who restores a backup under a running server, is gone at
// the next start.
class OpenedFiles {
 public:
  // As they are at `path` now.
  explicit OpenedFiles(std::string path);
  // Unavailable while one of them is not at its place. Costs two stats.
  absl::Status InPlace();

 private:
  struct File {
    std::string path;
    // None = it was not made yet.
    std::optional<std::pair<dev_t, ino_t>> id;
  };
  File files_[2];
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_SQLITE_FILE_H_
