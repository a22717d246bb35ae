#include "policy_server/server/store/sqlite_file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "policy_server/server/store/sqlite_db.h"
#include "services/base/status_macros.h"
#include "services/runtime/file_lock.h"

namespace rips::store {
namespace {

// "RIPS", so that another program's database is not taken for ours.
constexpr int kApplicationId = 0x52495053;

constexpr char kSchema[] = R"sql(
CREATE TABLE robots (
  robot TEXT PRIMARY KEY,
  level TEXT NOT NULL DEFAULT '',            -- name of the decided level
  term INTEGER NOT NULL DEFAULT 0,           -- the mark that decided it
  epoch INTEGER NOT NULL DEFAULT 0,
  highest_term INTEGER NOT NULL DEFAULT 0,
  tenure INTEGER NOT NULL DEFAULT 0,         -- drawn when the robot was acquired last; the fence
  soft_suspended INTEGER NOT NULL DEFAULT 0,
  rules_halted INTEGER NOT NULL DEFAULT 0,
  bundle TEXT NOT NULL DEFAULT '',           -- id of the bundle that was in force last
  alerts_forgotten INTEGER NOT NULL DEFAULT 0, -- highest sequence of an alert that was pruned
  resumed_term INTEGER NOT NULL DEFAULT 0,   -- the decision that stood when an operator let rules
  resumed_epoch INTEGER NOT NULL DEFAULT 0   -- lower soft levels again
) STRICT, WITHOUT ROWID;
CREATE TABLE notes (
  name TEXT PRIMARY KEY,
  value TEXT NOT NULL
) STRICT, WITHOUT ROWID;
CREATE TABLE generations (                   -- of the store; each start of the server begins one
  seq INTEGER PRIMARY KEY AUTOINCREMENT,
  id TEXT NOT NULL UNIQUE,                   -- 32 hex digits
  last_commit INTEGER NOT NULL               -- counted through all generations
) STRICT;
CREATE TABLE transitions (                   -- decisions and refusals, in the order of writing
  seq INTEGER PRIMARY KEY AUTOINCREMENT,
  id TEXT NOT NULL UNIQUE,
  robot TEXT NOT NULL,
  time_unix_ns INTEGER NOT NULL,
  from_level TEXT NOT NULL,
  to_level TEXT NOT NULL,
  cause TEXT NOT NULL,
  reason TEXT NOT NULL,
  refused INTEGER NOT NULL,
  term INTEGER NOT NULL,                     -- 0 when refused
  epoch INTEGER NOT NULL,
  based_term INTEGER NOT NULL,
  based_epoch INTEGER NOT NULL,
  count INTEGER NOT NULL,
  stage TEXT NOT NULL,
  detail TEXT NOT NULL,
  trace BLOB NOT NULL DEFAULT x''             -- why the rule fired: rips.v1.Evidence
) STRICT;
CREATE UNIQUE INDEX transitions_mark ON transitions (robot, term, epoch) WHERE refused = 0;
CREATE INDEX transitions_robot ON transitions (robot, seq);
CREATE INDEX transitions_refused ON transitions (seq) WHERE refused = 1;
CREATE TABLE alerts (
  seq INTEGER PRIMARY KEY AUTOINCREMENT,
  id TEXT NOT NULL UNIQUE,
  time_unix_ns INTEGER NOT NULL,
  robot TEXT NOT NULL,
  rule TEXT NOT NULL,
  severity TEXT NOT NULL,
  text TEXT NOT NULL,
  level TEXT NOT NULL,
  event TEXT NOT NULL,
  term INTEGER NOT NULL,
  epoch INTEGER NOT NULL,
  trace BLOB NOT NULL DEFAULT x'',            -- why the rule fired: rips.v1.Evidence
  ack_by TEXT NOT NULL DEFAULT '',           -- the operator who acknowledged it
  ack_note TEXT NOT NULL DEFAULT '',
  ack_unix_ns INTEGER NOT NULL DEFAULT 0,    -- 0 = it is not acknowledged
  maintenance TEXT NOT NULL DEFAULT ''       -- of the robot at that time, as text
) STRICT;
CREATE INDEX alerts_robot ON alerts (robot, seq);
CREATE INDEX alerts_open ON alerts (seq) WHERE ack_unix_ns = 0;
CREATE INDEX alerts_robot_open ON alerts (robot, seq) WHERE ack_unix_ns = 0;
CREATE INDEX alerts_grave ON alerts (seq) WHERE severity IN ('high', 'critical');
CREATE TABLE variables (
  robot TEXT NOT NULL,
  name TEXT NOT NULL,
  kind INTEGER NOT NULL,                     -- 0 int, 1 float (bits), 2 bool, 3 string
  number INTEGER NOT NULL,
  text TEXT NOT NULL,
  PRIMARY KEY (robot, name)
) STRICT, WITHOUT ROWID;
CREATE TABLE high_water (                    -- in the order in which a lane was first seen
  seq INTEGER PRIMARY KEY AUTOINCREMENT,
  robot TEXT NOT NULL,
  host TEXT NOT NULL,
  incarnation TEXT NOT NULL,
  lane INTEGER NOT NULL,                     -- 1 control, 2 messages
  sequence INTEGER NOT NULL,
  UNIQUE (robot, host, incarnation, lane)
) STRICT;
CREATE TABLE receipts (                      -- the newest of each command, in the order of writing
  seq INTEGER PRIMARY KEY AUTOINCREMENT,
  robot TEXT NOT NULL,
  host TEXT NOT NULL,
  command_id TEXT NOT NULL,                  -- hex digits
  command TEXT NOT NULL,
  time_unix_ns INTEGER NOT NULL,
  receipt BLOB NOT NULL,                     -- rips.v1.Receipt
  UNIQUE (robot, host, command_id)
) STRICT;
CREATE INDEX receipts_robot ON receipts (robot, seq);
CREATE TABLE bans (                          -- certificates that are not served any more
  uri TEXT NOT NULL,
  serial TEXT NOT NULL,                      -- empty = every certificate of the identity
  reason TEXT NOT NULL,
  by TEXT NOT NULL,
  time_unix_ns INTEGER NOT NULL,
  PRIMARY KEY (uri, serial)
) STRICT, WITHOUT ROWID;
CREATE TABLE maintenance (                   -- of robots whose agents may be away
  robot TEXT PRIMARY KEY,
  began_unix_ns INTEGER NOT NULL,
  until_unix_ns INTEGER NOT NULL,
  by TEXT NOT NULL,
  reason TEXT NOT NULL
) STRICT, WITHOUT ROWID;
)sql";

using FileId = std::pair<dev_t, ino_t>;

std::optional<FileId> IdOf(const std::string& path) {
  struct stat info = {};
  if (stat(path.c_str(), &info) != 0) return std::nullopt;
  return FileId{info.st_dev, info.st_ino};
}

absl::Status FromErrno(const std::string& doing) {
  return absl::UnavailableError(absl::StrCat(doing, ": ", std::strerror(errno)));
}

// What the operator can do about a damaged file; making a new one would forget every level.
absl::Status Damaged(const std::string& path, absl::string_view how) {
  return absl::DataLossError(absl::StrCat(
      "state file `", path, "` ", how,
      "; restore it from a backup, or move it away to start with no history (robots then keep the "
      "more restrictive of their own level and the start level)"));
}

absl::Status SyncDirectoryOf(const std::string& path) {
  const size_t slash = path.rfind('/');
  const std::string dir =
      slash == std::string::npos ? "." : (slash == 0 ? "/" : path.substr(0, slash));
  const int fd = open(dir.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return FromErrno(absl::StrCat("opening directory `", dir, "`"));
  const int result = fsync(fd);
  const absl::Status status =
      result == 0 ? absl::OkStatus() : FromErrno(absl::StrCat("syncing directory `", dir, "`"));
  close(fd);
  return status;
}

absl::Status MakeStateFile(const std::string& path) {
  const std::string fresh = path + ".new";
  for (const char* suffix : {"", "-journal", "-wal", "-shm"}) {
    if (unlink((fresh + suffix).c_str()) != 0 && errno != ENOENT) {
      return FromErrno(absl::StrCat("removing `", fresh, suffix, "`"));
    }
  }
  const int fd = open(fresh.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (fd < 0) return FromErrno(absl::StrCat("creating `", fresh, "`"));
  close(fd);
  {
    RIPS_ASSIGN_OR_RETURN(Database db, Database::Open(fresh, Database::Mode::kReadWrite));
    RIPS_RETURN_IF_ERROR(db.Execute("PRAGMA synchronous = FULL; BEGIN IMMEDIATE;"));
    RIPS_RETURN_IF_ERROR(db.Execute(kSchema));
    RIPS_RETURN_IF_ERROR(
        db.Execute(absl::StrCat("PRAGMA application_id = ", kApplicationId,
                                "; PRAGMA user_version = ", kSchemaVersion, "; COMMIT;")
                       .c_str()));
  }
  if (rename(fresh.c_str(), path.c_str()) != 0) {
    return FromErrno(absl::StrCat("renaming `", fresh, "`"));
  }
  return SyncDirectoryOf(path);
}

// What turns schema version N into N + 1, from version 1 on. `rips-policy-server` only ever moves a
// file forward.
constexpr const char* kUpgrades[] = {
    "ALTER TABLE robots ADD COLUMN rules_halted INTEGER NOT NULL DEFAULT 0",
    "CREATE TABLE bans (uri TEXT NOT NULL, serial TEXT NOT NULL, reason TEXT NOT NULL, by TEXT NOT "
    "NULL, time_unix_ns INTEGER NOT NULL, PRIMARY KEY (uri, serial)) STRICT, WITHOUT ROWID",
    "ALTER TABLE robots ADD COLUMN bundle TEXT NOT NULL DEFAULT '';"
    "ALTER TABLE robots ADD COLUMN alerts_forgotten INTEGER NOT NULL DEFAULT 0;"
    "CREATE TABLE notes (name TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT, WITHOUT ROWID;",
    "ALTER TABLE robots ADD COLUMN resumed_term INTEGER NOT NULL DEFAULT 0;"
    "ALTER TABLE robots ADD COLUMN resumed_epoch INTEGER NOT NULL DEFAULT 0;"
    "CREATE TABLE generations (seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, "
    "last_commit INTEGER NOT NULL) STRICT;",
    "ALTER TABLE transitions ADD COLUMN trace BLOB NOT NULL DEFAULT x'';"
    "ALTER TABLE alerts ADD COLUMN trace BLOB NOT NULL DEFAULT x'';",
    "ALTER TABLE robots ADD COLUMN tenure INTEGER NOT NULL DEFAULT 0",
    "CREATE TABLE receipts (seq INTEGER PRIMARY KEY AUTOINCREMENT, robot TEXT NOT NULL, host TEXT "
    "NOT NULL, command_id TEXT NOT NULL, command TEXT NOT NULL, time_unix_ns INTEGER NOT NULL, "
    "receipt BLOB NOT NULL, UNIQUE (robot, host, command_id)) STRICT;"
    "CREATE INDEX receipts_robot ON receipts (robot, seq);",
    "ALTER TABLE alerts ADD COLUMN ack_by TEXT NOT NULL DEFAULT '';"
    "ALTER TABLE alerts ADD COLUMN ack_note TEXT NOT NULL DEFAULT '';"
    "ALTER TABLE alerts ADD COLUMN ack_unix_ns INTEGER NOT NULL DEFAULT 0;"
    "CREATE INDEX alerts_open ON alerts (seq) WHERE ack_unix_ns = 0;"
    "CREATE INDEX alerts_robot_open ON alerts (robot, seq) WHERE ack_unix_ns = 0;"
    "CREATE INDEX alerts_grave ON alerts (seq) WHERE severity IN ('high', 'critical');",
    "ALTER TABLE alerts ADD COLUMN maintenance TEXT NOT NULL DEFAULT '';"
    "CREATE TABLE maintenance (robot TEXT PRIMARY KEY, began_unix_ns INTEGER NOT NULL, "
    "until_unix_ns INTEGER NOT NULL, by TEXT NOT NULL, reason TEXT NOT NULL) STRICT, "
    "WITHOUT ROWID;",
};
static_assert(std::size(kUpgrades) == kSchemaVersion - 1);

absl::Status Upgrade(int from, Database& db) {
  if (from == kSchemaVersion) return absl::OkStatus();
  RIPS_RETURN_IF_ERROR(db.Execute("PRAGMA synchronous = FULL; BEGIN IMMEDIATE;"));
  for (int version = from; version < kSchemaVersion; ++version) {
    RIPS_RETURN_IF_ERROR(db.Execute(kUpgrades[version - 1]));
  }
  return db.Execute(absl::StrCat("PRAGMA user_version = ", kSchemaVersion, "; COMMIT;").c_str());
}

absl::StatusOr<int> CheckVersion(const std::string& path, Database& db) {
  RIPS_ASSIGN_OR_RETURN(const std::string application, db.Ask("PRAGMA application_id"));
  if (application != absl::StrCat(kApplicationId)) {
    return Damaged(path, "is not a state file of the policy server");
  }
  RIPS_ASSIGN_OR_RETURN(const std::string text, db.Ask("PRAGMA user_version"));
  int version = 0;
  if (!absl::SimpleAtoi(text, &version) || version < 1) {
    return Damaged(path, absl::StrCat("has schema version ", text));
  }
  if (version > kSchemaVersion) {
    return absl::FailedPreconditionError(absl::StrCat("state file `", path, "` has schema version ",
                                                      version, ", this program knows up to ",
                                                      kSchemaVersion, "; run the newer program"));
  }
  return version;
}

// SQLite reads a page that is cut short as if the rest were zero. After a clean end (no log left) a
// file has whole pages only.
absl::Status CheckWholePages(const std::string& path, Database& db) {
  struct stat log = {};
  if (stat((path + "-wal").c_str(), &log) == 0 && log.st_size > 0) return absl::OkStatus();
  RIPS_ASSIGN_OR_RETURN(const std::string text, db.Ask("PRAGMA page_size"));
  int64_t page_bytes = 0;
  struct stat info = {};
  if (!absl::SimpleAtoi(text, &page_bytes) || page_bytes <= 0 || stat(path.c_str(), &info) != 0 ||
      info.st_size % page_bytes != 0) {
    return absl::DataLossError("its last page is cut short");
  }
  return absl::OkStatus();
}

absl::Status CheckStateFile(const std::string& path) {
  auto check = [&]() -> absl::Status {
    RIPS_ASSIGN_OR_RETURN(Database db, Database::Open(path, Database::Mode::kReadWrite));
    RIPS_RETURN_IF_ERROR(CheckWholePages(path, db));
    RIPS_ASSIGN_OR_RETURN(const int version, CheckVersion(path, db));
    RIPS_ASSIGN_OR_RETURN(const std::string verdict, db.Ask("PRAGMA quick_check(1)"));
    if (verdict != "ok") return absl::DataLossError(verdict);
    return Upgrade(version, db);
  };
  const absl::Status status = check();
  if (absl::IsDataLoss(status) && !absl::StrContains(status.message(), path)) {
    return Damaged(path, absl::StrCat("is damaged (", status.message(), ")"));
  }
  return status;
}

}  // namespace

absl::StatusOr<UniqueFd> LockStateFile(const std::string& path) {
  absl::StatusOr<UniqueFd> lock = LockFile(path + ".lock");
  if (absl::IsNotFound(lock.status())) {
    return absl::UnavailableError(absl::StrCat(
        "the directory of the state file `", path,
        "` does not exist; make it, and let it belong to the user of the policy server"));
  }
  if (absl::IsFailedPrecondition(lock.status())) {
    return absl::FailedPreconditionError(absl::StrCat(
        "state file `", path, "` is in use by another policy server; stop that one first"));
  }
  return lock;
}

absl::Status PrepareStateFile(const std::string& path) {
  struct stat info = {};
  if (stat(path.c_str(), &info) == 0) {
    if (!S_ISREG(info.st_mode)) {
      return absl::FailedPreconditionError(
          absl::StrCat("state file `", path, "` is not a regular file"));
    }
    if (info.st_size == 0) return Damaged(path, "is empty");
    return CheckStateFile(path);
  }
  if (errno != ENOENT) return FromErrno(absl::StrCat("opening state file `", path, "`"));
  struct stat log = {};
  if (stat((path + "-wal").c_str(), &log) == 0) {
    return Damaged(path, "is gone, but its write-ahead log is still there");
  }
  return MakeStateFile(path);
}

OpenedFiles::OpenedFiles(std::string path)
    : files_{{.path = path, .id = IdOf(path)}, {.path = path + "-wal", .id = IdOf(path + "-wal")}} {
}

absl::Status OpenedFiles::InPlace() {
  for (File& file : files_) {
    const std::optional<FileId> id = IdOf(file.path);
    if (!file.id.has_value()) file.id = id;
    if (id == file.id) continue;
    return absl::UnavailableError(absl::StrCat(
        "`", file.path, "` was removed, moved or replaced while the server uses it, and what is ",
        "recorded now would be lost; put the file back, or restart the server on what is there"));
  }
  return absl::OkStatus();
}

}  // namespace rips::store
