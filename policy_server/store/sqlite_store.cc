#include "policy_server/store/sqlite_store.h"

#include <utility>

#include "absl/base/thread_annotations.h"
#include "policy_server/store/sqlite_file.h"
#include "policy_server/store/sqlite_reader.h"
#include "policy_server/store/sqlite_writer.h"
#include "services/base/status_macros.h"
#include "services/runtime/mutex.h"

namespace rips::store {

// The two locks are never held together.
struct SqliteStore::Parts {
  Parts(FileLock taken_lock, SqliteWriter opened_writer, SqliteReader opened_reader)
      : lock(std::move(taken_lock)),
        writer(std::move(opened_writer)),
        reader(std::move(opened_reader)) {}

  FileLock lock;
  Mutex writer_mutex;
  SqliteWriter writer ABSL_GUARDED_BY(writer_mutex);
  Mutex reader_mutex;
  SqliteReader reader ABSL_GUARDED_BY(reader_mutex);
};

absl::StatusOr<std::unique_ptr<SqliteStore>> SqliteStore::Open(const std::string& path,
                                                               SqliteLimits limits) {
  RIPS_ASSIGN_OR_RETURN(FileLock lock, FileLock::Take(path));
  RIPS_RETURN_IF_ERROR(PrepareStateFile(path));
  RIPS_ASSIGN_OR_RETURN(SqliteWriter writer, SqliteWriter::Create(path, limits));
  RIPS_ASSIGN_OR_RETURN(SqliteReader reader, SqliteReader::Create(path));
  return std::unique_ptr<SqliteStore>(new SqliteStore(
      std::make_unique<Parts>(std::move(lock), std::move(writer), std::move(reader))));
}

SqliteStore::SqliteStore(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
SqliteStore::~SqliteStore() = default;

absl::StatusOr<RobotRecord> SqliteStore::Load(absl::string_view robot) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.Load(robot);
}

absl::StatusOr<uint64_t> SqliteStore::NextTerm(absl::string_view robot, uint64_t above) {
  MutexLock lock(&parts_->writer_mutex);
  return parts_->writer.NextTerm(robot, above);
}

absl::StatusOr<bool> SqliteStore::HasMark(absl::string_view robot, const Mark& mark) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.HasMark(robot, mark);
}

absl::Status SqliteStore::CommitAll(std::span<const WriteBatch> batches) {
  MutexLock lock(&parts_->writer_mutex);
  return parts_->writer.CommitAll(batches);
}

absl::StatusOr<std::vector<TransitionRecord>> SqliteStore::ListTransitions(absl::string_view robot,
                                                                           uint32_t limit) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.ListTransitions(robot, limit);
}

absl::StatusOr<std::vector<AlertRecord>> SqliteStore::ListAlerts(absl::string_view robot,
                                                                 uint32_t limit) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.ListAlerts(robot, limit);
}

}  // namespace rips::store
