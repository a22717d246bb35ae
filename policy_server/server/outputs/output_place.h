// How far an output has delivered: a cursor (operator_api/alert_feed.h), kept in the store's note
// `output/NAME`. A new output begins with the alerts that come from now on.
//
// The note is written at most once in kNoteNs, because each is a transaction of the store; after a
// crash what was delivered since is delivered again.
#ifndef RIPS_POLICY_SERVER_SERVER_OUTPUTS_OUTPUT_PLACE_H_
#define RIPS_POLICY_SERVER_SERVER_OUTPUTS_OUTPUT_PLACE_H_

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "policy_server/server/operator_api/alert_feed.h"
#include "policy_server/server/store/store.h"
#include "services/base/clock.h"

namespace rips::outputs {

// One thread at a time.
class OutputPlace {
 public:
  static constexpr int64_t kNoteNs = 2 * kNanosPerSecond;

  // `store` is not owned and outlives this.
  OutputPlace(store::Store* store, const std::string& name);

  // Reads the note, once; a new output's is written at once. `newest`: Store::NewestAlert. An error
  // is of the store: try again.
  absl::Status Find(const store::AlertRecord& newest);
  // The store does not know the cursor of the note: it goes on with the newest alert. Until Accept
  // the note stays as it is.
  bool lost() const { return lost_; }
  // The receiver knows that the place was lost.
  void Accept() { lost_ = false; }

  // After Find.
  uint64_t sequence() const { return cursor_->sequence; }
  void Advance(const store::AlertRecord& delivered);
  // Writes the note if it is due, or if `at_once`. What cannot be written is tried again.
  void Remember(int64_t now_ns, bool at_once);

 private:
  store::Store* store_;
  const std::string note_;
  // None before Find.
  std::optional<operator_api::Cursor> cursor_;
  bool lost_ = false;
  std::string noted_;
  int64_t noted_ns_ = 0;
};

}  // namespace rips::outputs

#endif  // RIPS_POLICY_SERVER_SERVER_OUTPUTS_OUTPUT_PLACE_H_
