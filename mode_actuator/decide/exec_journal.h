// Which exec commands were begun and how they ended, so that each runs at most once, also when the
// actuator dies in the middle. Pure; the caller writes Encode() to disk before it starts a program.
//
// On disk:  rips-actuator-journal 1
//           <32 hex id> <stage: 1 begun, else rips.v1.Receipt.Stage> <exit code>     (oldest first)
//           crc <8 hex digits, CRC-32 of all before>
#ifndef RIPS_MODE_ACTUATOR_DECIDE_EXEC_JOURNAL_H_
#define RIPS_MODE_ACTUATOR_DECIDE_EXEC_JOURNAL_H_

#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/decide/receipt.h"

namespace rips::actuator {

// Ids remembered; the oldest finished one is forgotten first.
inline constexpr size_t kExecIdsMax = 512;
inline constexpr size_t kJournalBytesMax = 64 << 10;

class ExecJournal {
 public:
  // DataLoss for bytes that Encode did not give.
  static absl::StatusOr<ExecJournal> Decode(absl::string_view bytes);
  std::string Encode() const;

  // A command that was begun before: its receipt as known (output is not remembered).
  std::optional<Receipt> Find(absl::string_view id) const;
  // ResourceExhausted if kExecIdsMax are running.
  absl::Status Begin(absl::string_view id);
  void Finish(absl::string_view id, Receipt::Stage stage, int exit_code);
  // Takes a Begin back: nothing was started.
  void Forget(absl::string_view id);
  // After a start: what was begun and not finished is finished as kUnknown; these are the receipts.
  std::vector<Receipt> CloseUnfinished();

 private:
  struct Entry {
    std::string id;
    Receipt::Stage stage = Receipt::Stage::kAcknowledged;
    int exit_code = 0;
  };
  static Receipt ToReceipt(const Entry& entry);

  std::deque<Entry> entries_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_EXEC_JOURNAL_H_
