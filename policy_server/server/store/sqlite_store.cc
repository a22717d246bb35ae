#include "policy_server/server/store/sqlite_store.h"

#include <algorithm>
#include <atomic>
#include <functional>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "policy_server/server/store/disk_reserve.h"
#include "policy_server/server/store/sqlite_file.h"
#include "policy_server/server/store/sqlite_reader.h"
#include "policy_server/server/store/sqlite_writer.h"
#include "services/base/status_macros.h"
#include "services/runtime/mutex.h"

namespace rips::store {
namespace {

// Of the reserve, that opening may use: a disk that fails for another reason does not cost all of
// it.
constexpr int kOpeningPiecesMax = 2;

}  // namespace

// The two locks are never held together.
struct SqliteStore::Parts {
  Parts(const std::string& path, UniqueFd taken_lock, DiskReserve opened_reserve,
        SqliteWriter opened_writer, SqliteReader opened_reader)
      : lock(std::move(taken_lock)),
        files(path),
        reserve(std::move(opened_reserve)),
        writer(std::move(opened_writer)),
        reader(std::move(opened_reader)) {}

  // `write` may be tried again: a full disk gets room from the reserve, piece by piece.
  absl::Status WithReserve(const std::function<absl::Status(SqliteWriter&)>& write)
      ABSL_EXCLUSIVE_LOCKS_REQUIRED(writer_mutex) {
    RIPS_RETURN_IF_ERROR(files.InPlace());
    absl::Status status = write(writer);
    while (absl::IsResourceExhausted(status) && reserve.Release()) status = write(writer);
    return status;
  }

  UniqueFd lock;
  Mutex writer_mutex;
  OpenedFiles files ABSL_GUARDED_BY(writer_mutex);
  DiskReserve reserve ABSL_GUARDED_BY(writer_mutex);
  SqliteWriter writer ABSL_GUARDED_BY(writer_mutex);
  // The writer's, for those who do not wait for it.
  std::atomic<uint64_t> newest_commit = 0;
  Mutex reader_mutex;
  SqliteReader reader ABSL_GUARDED_BY(reader_mutex);
};

absl::StatusOr<std::unique_ptr<SqliteStore>> SqliteStore::Open(const std::string& path,
                                                               SqliteLimits limits) {
  RIPS_ASSIGN_OR_RETURN(UniqueFd lock, LockStateFile(path));
  absl::Status prepared = PrepareStateFile(path);
  absl::StatusOr<DiskReserve> reserve = DiskReserve::Open(path + ".reserve", limits.reserve_bytes);
  if (!reserve.ok()) return prepared.ok() ? reserve.status() : prepared;
  for (int pieces = 0;; ++pieces) {
    absl::Status status = prepared;
    if (status.ok()) {
      absl::StatusOr<SqliteWriter> writer = SqliteWriter::Create(path, limits);
      absl::StatusOr<SqliteReader> reader =
          writer.ok() ? SqliteReader::Create(path) : writer.status();
      if (reader.ok()) {
        return std::unique_ptr<SqliteStore>(new SqliteStore(std::make_unique<Parts>(
            path, std::move(lock), *std::move(reserve), *std::move(writer), *std::move(reader))));
      }
      status = reader.status();
    }
    // Opening needs room, too. SQLite reports its lack as an I/O error, hence Unavailable.
    const bool perhaps_full = absl::IsResourceExhausted(status) || absl::IsUnavailable(status);
    if (!perhaps_full || pieces == kOpeningPiecesMax || !reserve->Release()) return status;
    prepared = PrepareStateFile(path);
  }
}

SqliteStore::SqliteStore(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
SqliteStore::~SqliteStore() = default;

absl::StatusOr<RobotRecord> SqliteStore::Load(absl::string_view robot) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.Load(robot);
}

absl::StatusOr<std::vector<Acquired>> SqliteStore::Acquire(std::span<const std::string> robots) {
  std::vector<uint64_t> tenures;
  {
    MutexLock lock(&parts_->writer_mutex);
    // Without a term no robot can be commanded at all.
    RIPS_RETURN_IF_ERROR(parts_->WithReserve([&](SqliteWriter& writer) -> absl::Status {
      RIPS_ASSIGN_OR_RETURN(tenures, writer.Acquire(robots));
      return absl::OkStatus();
    }));
  }
  // Read afterwards: nothing of an earlier tenure is written any more.
  std::vector<Acquired> acquired;
  MutexLock lock(&parts_->reader_mutex);
  for (size_t i = 0; i < robots.size(); ++i) {
    RIPS_ASSIGN_OR_RETURN(RobotRecord record, parts_->reader.Load(robots[i]));
    acquired.push_back({.record = std::move(record), .tenure = tenures[i]});
  }
  return acquired;
}

absl::StatusOr<uint64_t> SqliteStore::NextTerm(absl::string_view robot, uint64_t tenure,
                                               uint64_t above) {
  MutexLock lock(&parts_->writer_mutex);
  uint64_t term = 0;
  RIPS_RETURN_IF_ERROR(parts_->WithReserve([&](SqliteWriter& writer) -> absl::Status {
    RIPS_ASSIGN_OR_RETURN(term, writer.NextTerm(robot, tenure, above));
    return absl::OkStatus();
  }));
  return term;
}

absl::StatusOr<std::optional<std::string>> SqliteStore::FindDecision(
    absl::string_view robot, const DecisionId& decision_id) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.FindDecision(robot, decision_id);
}

absl::Status SqliteStore::BeginGeneration(absl::string_view id) {
  MutexLock lock(&parts_->writer_mutex);
  // Drawn at each start, as terms are.
  RIPS_RETURN_IF_ERROR(
      parts_->WithReserve([&](SqliteWriter& writer) { return writer.BeginGeneration(id); }));
  parts_->newest_commit = parts_->writer.newest_commit();
  return absl::OkStatus();
}

absl::StatusOr<std::vector<Generation>> SqliteStore::Generations() {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.Generations();
}

uint64_t SqliteStore::newest_commit() const { return parts_->newest_commit; }

absl::StatusOr<std::vector<absl::Status>> SqliteStore::CommitAll(
    std::span<const WriteBatch> batches) {
  MutexLock lock(&parts_->writer_mutex);
  const bool may_use_reserve =
      !batches.empty() && std::all_of(batches.begin(), batches.end(),
                                      [](const WriteBatch& batch) { return batch.uses_reserve; });
  std::vector<absl::Status> statuses;
  const auto write = [&](SqliteWriter& writer) -> absl::Status {
    RIPS_ASSIGN_OR_RETURN(statuses, writer.CommitAll(batches));
    return absl::OkStatus();
  };
  if (may_use_reserve) {
    RIPS_RETURN_IF_ERROR(parts_->WithReserve(write));
  } else {
    RIPS_RETURN_IF_ERROR(parts_->files.InPlace());
    // What the reserve has given up is for decisions: others wait until it is whole again.
    RIPS_RETURN_IF_ERROR(parts_->reserve.Refill());
    RIPS_RETURN_IF_ERROR(write(parts_->writer));
  }
  parts_->newest_commit = parts_->writer.newest_commit();
  return statuses;
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

absl::StatusOr<std::vector<ReceiptRecord>> SqliteStore::ListReceipts(absl::string_view robot,
                                                                     uint32_t limit) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.ListReceipts(robot, limit);
}

absl::StatusOr<AlertPage> SqliteStore::AlertsAfter(absl::string_view robot, uint64_t sequence,
                                                   uint32_t limit) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.AlertsAfter(robot, sequence, limit);
}

absl::StatusOr<FoundRecords> SqliteStore::FindRecords(absl::string_view prefix) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.FindRecords(prefix);
}

absl::StatusOr<uint64_t> SqliteStore::FindAlert(absl::string_view id) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.FindAlert(id);
}

absl::StatusOr<AlertRecord> SqliteStore::NewestAlert() {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.NewestAlert();
}

absl::StatusOr<std::string> SqliteStore::Note(absl::string_view name) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.Note(name);
}

absl::Status SqliteStore::SetNote(absl::string_view name, absl::string_view value) {
  RIPS_RETURN_IF_ERROR(CheckNote(name, value));
  MutexLock lock(&parts_->writer_mutex);
  RIPS_RETURN_IF_ERROR(parts_->files.InPlace());
  RIPS_RETURN_IF_ERROR(parts_->reserve.Refill());
  return parts_->writer.SetNote(name, value);
}

absl::Status SqliteStore::PutBan(const BanRecord& ban) {
  MutexLock lock(&parts_->writer_mutex);
  RIPS_RETURN_IF_ERROR(parts_->files.InPlace());
  return parts_->writer.PutBan(ban);
}

absl::StatusOr<bool> SqliteStore::RemoveBan(absl::string_view uri, absl::string_view serial) {
  MutexLock lock(&parts_->writer_mutex);
  RIPS_RETURN_IF_ERROR(parts_->files.InPlace());
  return parts_->writer.RemoveBan(uri, serial);
}

absl::StatusOr<std::vector<BanRecord>> SqliteStore::ListBans() {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.ListBans();
}

absl::StatusOr<std::vector<AckRecord>> SqliteStore::FindAcks(
    std::span<const std::string> alert_ids) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.FindAcks(alert_ids);
}

absl::StatusOr<AlertList> SqliteStore::SearchAlerts(const AlertQuery& query) {
  MutexLock lock(&parts_->reader_mutex);
  return parts_->reader.SearchAlerts(query);
}

}  // namespace rips::store
