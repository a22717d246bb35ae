#include "policy_server/server/operator_api/alert_feed.h"

#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "services/base/status_macros.h"
#include "services/runtime/log.h"

namespace rips::operator_api {
namespace {

// Of the store: id of the newest alert that the file has.
constexpr char kFileNote[] = "alert_file";
// How many looks pass between two notes: a note is a transaction.
constexpr int kLooksPerNote = 10;

constexpr char kForgotten[] =
    "alerts before this one were forgotten by the limit of the store; the alert file has them";
constexpr char kUnknownCursor[] =
    "the cursor is of another store (it was made anew, or a backup was restored): alerts may be "
    "missing; see `ripsctl alert list`";

}  // namespace

std::string FormatCursor(const Cursor& cursor) {
  if (cursor.sequence == 0) return "0";
  return absl::StrCat(cursor.sequence, "-", cursor.id);
}

absl::StatusOr<Cursor> ParseCursor(absl::string_view text) {
  Cursor cursor;
  if (text == "0") return cursor;
  const size_t dash = text.find('-');
  const bool whole = dash != absl::string_view::npos &&
                     absl::SimpleAtoi(text.substr(0, dash), &cursor.sequence) &&
                     cursor.sequence > 0 && cursor.sequence <= store::kNumberMax;
  if (whole) cursor.id = std::string(text.substr(dash + 1));
  if (!whole || cursor.id.empty() || cursor.id.size() > 64 || FormatCursor(cursor) != text) {
    return absl::InvalidArgumentError(
        absl::StrCat("`", absl::CHexEscape(text.substr(0, 100)),
                     "` is not a cursor; write one as `alert watch "
                     "--output json` shows it, or 0 for all that is stored"));
  }
  return cursor;
}

absl::StatusOr<CursorPlace> FindCursor(store::Store& store, const Cursor& cursor,
                                       const store::AlertRecord& newest) {
  if (cursor.sequence == 0) return CursorPlace::kKnown;
  RIPS_ASSIGN_OR_RETURN(const uint64_t sequence, store.FindAlert(cursor.id));
  if (sequence == cursor.sequence) return CursorPlace::kKnown;
  RIPS_ASSIGN_OR_RETURN(const store::AlertPage page, store.AlertsAfter("", cursor.sequence - 1, 1));
  const bool forgotten = sequence == 0 && page.forgotten && cursor.sequence <= newest.sequence;
  return forgotten ? CursorPlace::kForgotten : CursorPlace::kUnknown;
}

AlertFeed::AlertFeed(store::Store* store, store::AlertLog* log, FeedCounts counts,
                     absl::Duration interval)
    : store_(store), log_(log), counts_(std::move(counts)), interval_(interval) {
  // Before there can be new alerts: after a backup was restored, the file goes on with the first.
  if (log_ != nullptr) FindFilePlace().IgnoreError();  // tried again at the first look
  if (interval_ != absl::InfiniteDuration()) thread_ = std::thread([this] { Run(); });
}

AlertFeed::~AlertFeed() { Stop(); }

void AlertFeed::Stop() {
  {
    MutexLock lock(&mu_);
    if (std::exchange(stopping_, true)) return;
    woken_.NotifyAll();
  }
  if (thread_.joinable()) thread_.join();
  if (log_ != nullptr && !file_id_.empty()) RememberFilePlace(file_id_);
}

void AlertFeed::Watch(uint64_t id, std::optional<Cursor> after, AlertWatcher watcher) {
  auto watching = std::make_shared<Watching>();
  watching->watcher = std::move(watcher);
  watching->after = std::move(after);
  MutexLock lock(&mu_);
  watching_[id] = std::move(watching);
  wake_ = true;
  woken_.NotifyAll();
}

void AlertFeed::Unwatch(uint64_t id) {
  MutexLock lock(&mu_);
  watching_.erase(id);
}

void AlertFeed::Notify(const std::string& text) {
  MutexLock lock(&mu_);
  notice_ = text;
  wake_ = true;
  woken_.NotifyAll();
}

void AlertFeed::Wake() {
  MutexLock lock(&mu_);
  wake_ = true;
  woken_.NotifyAll();
}

void AlertFeed::Run() {
  bool stopping = false;
  while (!stopping) {
    {
      MutexLock lock(&mu_);
      if (!wake_ && !stopping_) woken_.WaitFor(lock, interval_);
      wake_ = false;
      stopping = stopping_;
    }
    Look();
  }
}

void AlertFeed::Look() {
  if (log_ != nullptr) FeedFile();
  std::map<uint64_t, std::shared_ptr<Watching>> watching;
  std::string notice;
  {
    MutexLock lock(&mu_);
    watching = watching_;
    notice = std::exchange(notice_, {});
  }
  if (watching.empty()) return;
  if (!notice.empty()) {
    for (const auto& [id, each] : watching) each->watcher.gap(notice);
  }
  const absl::StatusOr<store::AlertRecord> newest = store_->NewestAlert();
  if (!newest.ok()) return;  // tried again at the next look
  // Without the lock: a watcher may call back.
  for (const auto& [id, each] : watching) {
    if (Feed(*each, *newest)) continue;
    Unwatch(id);
    if (on_left_) on_left_(id);
  }
}

// ------------------------------------------------------------------------------------ the file

// Where the file ends, in the store's order. What is not known there (a backup was restored, or the
// limit has forgotten it) cannot be gone on from: then it begins with what comes from now on.
absl::Status AlertFeed::FindFilePlace() {
  RIPS_ASSIGN_OR_RETURN(std::string id, log_->LastId());
  RIPS_ASSIGN_OR_RETURN(const std::string noted, store_->Note(kFileNote));
  if (id.empty()) id = noted;
  RIPS_ASSIGN_OR_RETURN(const store::AlertRecord newest, store_->NewestAlert());
  RIPS_ASSIGN_OR_RETURN(uint64_t sequence, store_->FindAlert(id));
  if (sequence == 0 && !id.empty()) {
    LogWarning(
        "the store does not know the newest alert of the alert file: it is older, or another one; "
        "alerts of the time between are in the file, and not in `ripsctl alert list`",
        {{"alert", id}});
    sequence = newest.sequence;
    id = newest.id;
  }
  file_sequence_ = sequence;
  file_id_ = id;
  noted_id_ = noted;
  return absl::OkStatus();
}

void AlertFeed::RememberFilePlace(const std::string& id) {
  looks_since_note_ = 0;
  if (id == noted_id_ || !store_->SetNote(kFileNote, id).ok()) return;
  noted_id_ = id;
}

void AlertFeed::FeedFile() {
  const auto feed = [&]() -> absl::Status {
    if (!file_sequence_.has_value()) RIPS_RETURN_IF_ERROR(FindFilePlace());
    while (true) {
      RIPS_ASSIGN_OR_RETURN(const store::AlertPage page,
                            store_->AlertsAfter("", *file_sequence_, kPage));
      if (page.alerts.empty()) return absl::OkStatus();
      RIPS_ASSIGN_OR_RETURN(const size_t written, log_->Append(page.alerts));
      const store::AlertRecord& last = page.alerts[written - 1];
      file_sequence_ = last.sequence;
      file_id_ = last.id;
    }
  };
  const absl::Status status = feed();
  if (!status.ok()) {
    if (counts_.file_failures) counts_.file_failures(1);
    if (!file_failing_) {
      LogError("cannot write the alert file; retrying, no alert is skipped",
               {{"reason", status.message()}});
    }
  } else if (file_failing_) {
    LogInfo("alert file is writable again");
  }
  file_failing_ = !status.ok();
  if (++looks_since_note_ >= kLooksPerNote && !file_id_.empty()) RememberFilePlace(file_id_);
}

// --------------------------------------------------------------------------------- the watches

// True if it is placed and interested.
absl::StatusOr<bool> AlertFeed::Place(Watching& watching, const store::AlertRecord& newest) {
  Cursor at{.sequence = newest.sequence, .id = newest.id};
  bool unknown = false;
  if (watching.after.has_value()) {
    RIPS_ASSIGN_OR_RETURN(const CursorPlace place, FindCursor(*store_, *watching.after, newest));
    unknown = place == CursorPlace::kUnknown;
    if (!unknown) at = *watching.after;
  }
  watching.placed = true;
  watching.sequence = at.sequence;
  if (!watching.watcher.position(at)) return false;
  return !unknown || watching.watcher.gap(kUnknownCursor);
}

bool AlertFeed::Feed(Watching& watching, const store::AlertRecord& newest) {
  const AlertWatcher& watcher = watching.watcher;
  if (!watching.placed) {
    const absl::StatusOr<bool> placed = Place(watching, newest);
    if (!placed.ok()) return true;
    if (!*placed) return false;
  }
  while (watching.sequence < newest.sequence) {
    if (!watcher.room()) return true;
    const absl::StatusOr<store::AlertPage> page =
        store_->AlertsAfter(watcher.robot, watching.sequence, kPage);
    if (!page.ok()) return true;
    if (page->alerts.empty()) {
      // Those in between are of others.
      watching.sequence = newest.sequence;
      break;
    }
    const bool gap_told = std::exchange(watching.gap_told, page->forgotten);
    if (page->forgotten && !gap_told && !watcher.gap(kForgotten)) return false;
    for (const store::AlertRecord& alert : page->alerts) {
      if (!watcher.alert(alert)) return false;
      watching.sequence = alert.sequence;
    }
  }
  return true;
}

}  // namespace rips::operator_api
