#include "policy_server/server/audit/audit_log.h"

#include <iterator>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "services/base/cut_text.h"
#include "services/base/status_macros.h"
#include "services/text/utf8.h"

namespace rips::audit {
namespace {

// Of one text of a record; all of them together fit kPayloadBytesMax.
constexpr size_t kTextBytesMax = 4'096;
constexpr absl::Duration kRetry = absl::Seconds(1);

v1::AuditRecord OfLog(int64_t unix_ns, std::string text) {
  v1::AuditRecord record;
  record.set_time_unix_ns(unix_ns);
  record.set_kind(v1::AuditRecord::KIND_LOG);
  record.set_actor("(rips)");
  record.set_text(std::move(text));
  return record;
}

void CutTexts(v1::AuditRecord& record) {
  for (std::string* text :
       {record.mutable_robot(), record.mutable_id(), record.mutable_actor(),
        record.mutable_address(), record.mutable_action(), record.mutable_from(),
        record.mutable_to(), record.mutable_text(), record.mutable_outcome()}) {
    // Hostile text may be any bytes; the proto's strings may not.
    if (FindInvalidUtf8(*text)) *text = absl::CHexEscape(*text);
    *text = Shortened(*text, kTextBytesMax);
  }
}

// With a text of its own. Copies of a status share theirs, counted inside Debian's library, where
// ThreadSanitizer does not see that threads take turns.
absl::Status Copy(const absl::Status& status) { return {status.code(), status.message()}; }

}  // namespace

absl::StatusOr<std::unique_ptr<AuditLog>> AuditLog::Open(const AuditOptions& options,
                                                         const Clock* clock) {
  RIPS_ASSIGN_OR_RETURN(
      std::unique_ptr<SegmentWriter> writer,
      SegmentWriter::Open(options.directory, options.segment_bytes, clock->Now().unix_ns));
  const bool begun = writer->head().sequence == 0;
  std::unique_ptr<AuditLog> log(new AuditLog(std::move(writer), options, clock));
  RIPS_RETURN_IF_ERROR(
      log->Commit({OfLog(clock->Now().unix_ns,
                         begun ? "the log was begun" : "the log was opened by a server's start")}));
  return log;
}

AuditLog::AuditLog(std::unique_ptr<SegmentWriter> writer, const AuditOptions& options,
                   const Clock* clock)
    : options_(options), clock_(clock), writer_(std::move(writer)), thread_([this] { Run(); }) {}

AuditLog::~AuditLog() {
  {
    MutexLock lock(&mu_);
    stopping_ = true;
    changed_.NotifyAll();
    stopped_.NotifyAll();
  }
  thread_.join();
}

void AuditLog::Run() {
  bool failed = false;
  while (true) {
    {
      MutexLock lock(&mu_);
      if (failed && !stopping_) stopped_.WaitFor(lock, kRetry);
      while (waiting_.empty() && !stopping_) changed_.Wait(lock);
      if (stopping_ && (waiting_.empty() || failed)) return;
    }
    failed = !Commit({}).ok();
  }
}

void AuditLog::Add(v1::AuditRecord record) {
  CutTexts(record);
  MutexLock lock(&mu_);
  if (waiting_.size() >= options_.waiting_max) {
    waiting_.pop_front();
    ++dropped_;
  }
  waiting_.push_back(std::move(record));
  changed_.NotifyOne();
}

absl::Status AuditLog::health() const {
  MutexLock lock(&mu_);
  return Copy(health_);
}

Head AuditLog::head() const {
  MutexLock lock(&mu_);
  return head_;
}

model::AuditHead AuditLog::sealed() const {
  MutexLock lock(&mu_);
  return sealed_;
}

absl::Status AuditLog::Write(std::vector<v1::AuditRecord>& records, bool wants_gap) {
  const int64_t now = clock_->Now().unix_ns;
  std::vector<std::string> payloads;
  if (wants_gap) {
    MutexLock lock(&mu_);
    payloads.push_back(OfLog(now, absl::StrCat("the log could not be written for ",
                                               (now - failed_unix_ns_) / kNanosPerSecond, " s, ",
                                               dropped_, " records are lost: ", health_.message()))
                           .SerializeAsString());
  }
  for (v1::AuditRecord& record : records) {
    CutTexts(record);
    if (record.time_unix_ns() == 0) record.set_time_unix_ns(now);
    payloads.push_back(record.SerializeAsString());
  }
  if (payloads.empty()) return absl::OkStatus();
  const absl::Status status = writer_->Append(payloads, now);
  if (!status.ok() && options_.on_failure) options_.on_failure();
  MutexLock lock(&mu_);
  head_ = writer_->head();
  sealed_ = writer_->sealed();
  if (status.ok() && wants_gap) dropped_ = 0;
  if (!status.ok() && health_.ok()) failed_unix_ns_ = now;
  health_ = Copy(status);
  return status;
}

absl::Status AuditLog::Commit(std::vector<v1::AuditRecord> records) {
  MutexLock file(&file_mu_);
  std::vector<v1::AuditRecord> all;
  bool wants_gap = false;
  {
    MutexLock lock(&mu_);
    wants_gap = !health_.ok() || dropped_ > 0;
    all.assign(std::make_move_iterator(waiting_.begin()), std::make_move_iterator(waiting_.end()));
    waiting_.clear();
  }
  const size_t waited = all.size();
  std::move(records.begin(), records.end(), std::back_inserter(all));
  const absl::Status status = Write(all, wants_gap);
  if (!status.ok()) {
    MutexLock lock(&mu_);
    waiting_.insert(waiting_.begin(), std::make_move_iterator(all.begin()),
                    std::make_move_iterator(all.begin() + static_cast<ptrdiff_t>(waited)));
    while (waiting_.size() > options_.waiting_max) {
      waiting_.pop_front();
      ++dropped_;
    }
  }
  return status;
}

}  // namespace rips::audit
