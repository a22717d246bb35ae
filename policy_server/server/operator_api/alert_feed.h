// Alerts from the store to those who follow them: the alert file, and operators' watches. The
// store's order of writing is everybody's order; each follower has a place in it, so none has a
// hole and none is told twice, whatever fails in between.
//
//   follower   place                              when it cannot be told
//   file       the alert on its last line, or a   counted and logged once; tried again each second,
//              note in the store if it is new     from where it stopped
//   watch      a cursor of the operator's         not told more until it has read; goes on then
//
// A cursor is "SEQUENCE-ID" of the alert told last, or "0" before the first. One that the store does
// not know (it was made anew, or a backup was restored), and alerts that the store has forgotten by
// its limit in the meantime, are told as a gap.
#ifndef RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ALERT_FEED_H_
#define RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ALERT_FEED_H_

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/server/store/alert_log.h"
#include "policy_server/server/store/store.h"
#include "services/runtime/mutex.h"

namespace rips::operator_api {

struct Cursor {
  uint64_t sequence = 0;
  std::string id;

  friend bool operator==(const Cursor&, const Cursor&) = default;
};
std::string FormatCursor(const Cursor& cursor);
// InvalidArgument with an example for what FormatCursor does not make.
absl::StatusOr<Cursor> ParseCursor(absl::string_view text);

// What the store knows of the alert that a cursor names. kForgotten: it was there, and the limit
// has forgotten it. kUnknown: the store was made anew, or a backup was restored.
enum class CursorPlace { kKnown, kForgotten, kUnknown };
// `newest`: Store::NewestAlert. An error is of the store.
absl::StatusOr<CursorPlace> FindCursor(store::Store& store, const Cursor& cursor,
                                       const store::AlertRecord& newest);

// One who follows. Called on the feed's thread, must not block; false = no longer interested.
struct AlertWatcher {
  // Empty = all.
  std::string robot;
  // More can be told now without anything being dropped.
  std::function<bool()> room;
  // With its sequence.
  std::function<bool(const store::AlertRecord&)> alert;
  // Once, at first: where it begins.
  std::function<bool(const Cursor&)> position;
  // What is missing before the next alert, or will be late; printable.
  std::function<bool(const std::string&)> gap;
};

// What is counted; a null entry is not.
struct FeedCounts {
  // Attempts to write alerts to the file that failed.
  std::function<void(uint64_t)> file_failures;
  // An alert whose trace leaves something out was recorded. Any thread; must not block.
  std::function<void()> cut_traces;
};

class AlertFeed {
 public:
  // Alerts read at one time.
  static constexpr uint32_t kPage = 256;

  // `log` may be null (no file). Looks when woken and every `interval`, on a thread of its own;
  // InfiniteDuration = only when asked. Nothing is owned; all outlive this.
  AlertFeed(store::Store* store, store::AlertLog* log, FeedCounts counts,
            absl::Duration interval = absl::Seconds(1));
  // As Stop.
  ~AlertFeed();

  // `after`: none = from now on. The caller sees to the number of watchers.
  void Watch(uint64_t id, std::optional<Cursor> after, AlertWatcher watcher)
      ABSL_LOCKS_EXCLUDED(mu_);
  // It may still be told what is being told now. An id that is gone does nothing.
  void Unwatch(uint64_t id) ABSL_LOCKS_EXCLUDED(mu_);
  // Tells those who watch now what no alert can tell yet, as a gap: cannot write the store.
  // Any thread; never blocks. A newer text replaces one that was not told yet.
  void Notify(const std::string& text) ABSL_LOCKS_EXCLUDED(mu_);
  // There are new alerts, or somebody has room again. Any thread; never blocks.
  void Wake() ABSL_LOCKS_EXCLUDED(mu_);
  // Tells everybody what there is. One thread at a time; not beside the thread of its own.
  void Look() ABSL_LOCKS_EXCLUDED(mu_);
  // Ends the thread after a last look. Idempotent.
  void Stop() ABSL_LOCKS_EXCLUDED(mu_);
  // Called with the id of a watcher that is no longer interested, on the feed's thread.
  void set_on_left(std::function<void(uint64_t)> on_left) { on_left_ = std::move(on_left); }

 private:
  struct Watching {
    AlertWatcher watcher;
    std::optional<Cursor> after;
    bool placed = false;
    bool gap_told = false;
    // Told up to here.
    uint64_t sequence = 0;
  };
  void Run();
  void FeedFile();
  absl::Status FindFilePlace();
  void RememberFilePlace(const std::string& id);
  // False: it is not interested any more.
  bool Feed(Watching& watching, const store::AlertRecord& newest);
  absl::StatusOr<bool> Place(Watching& watching, const store::AlertRecord& newest);

  store::Store* store_;
  store::AlertLog* log_;
  const FeedCounts counts_;
  const absl::Duration interval_;
  std::function<void(uint64_t)> on_left_;
  // The thread that looks, alone.
  std::optional<uint64_t> file_sequence_;
  std::string file_id_;
  std::string noted_id_;
  int looks_since_note_ = 0;
  bool file_failing_ = false;

  Mutex mu_;
  CondVar woken_;
  bool wake_ ABSL_GUARDED_BY(mu_) = false;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  // Of Notify, not told yet.
  std::string notice_ ABSL_GUARDED_BY(mu_);
  std::map<uint64_t, std::shared_ptr<Watching>> watching_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace rips::operator_api

#endif  // RIPS_POLICY_SERVER_SERVER_OPERATOR_API_ALERT_FEED_H_
