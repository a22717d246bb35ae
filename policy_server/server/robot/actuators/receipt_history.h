// What the actuators of one robot answered, for people: the newest receipt of each command. Pure;
// not thread-safe.
//
// The wire repeats receipts and a peer may lie, so a command's stage only moves up this order; what
// would move it down, and what repeats what is known, is dropped:
//   acknowledged < unknown < refused, refused_stale < failed < superseded < verified
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_RECEIPT_HISTORY_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_RECEIPT_HISTORY_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/server/robot/model/actuator_inbound.h"
#include "policy_server/server/robot/model/outbound.h"
#include "policy_server/server/store/records.h"

namespace rips::pipeline {

// The oldest goes first.
inline constexpr size_t kReceiptsKept = 64;
// Of them, of commands that this server did not send or has forgotten.
inline constexpr size_t kStrangeReceiptsKept = 16;
// Of them, of one decision and actuator: a level that fails is commanded again and again.
inline constexpr size_t kAttemptsKept = 4;
// Commands whose receipts are recognised.
inline constexpr size_t kCommandsKnown = 256;
// What is kept of one receipt; failed steps come first where there is too much.
inline constexpr size_t kReceiptBytesKept = 48 << 10;
inline constexpr size_t kReceiptStepsKept = 128;
inline constexpr size_t kStepNameBytesKept = 128;
inline constexpr size_t kDetailBytesKept = 1024;
inline constexpr size_t kOutputBytesKept = 4 << 10;  // from the end

using LoggedReceipt = store::ReceiptRecord;
// LoggedReceipt::command of one that this server did not send, or has forgotten.
inline constexpr absl::string_view kUnknownCommand = "unknown command";

class ReceiptHistory {
 public:
  // `command` went to `host`.
  void Sent(const std::string& host, const Command& command);
  // What is to be recorded of it, so that a peer cannot fill a disk: nullptr unless it is of a
  // command that this server sent and has not forgotten, and moves its stage up. Valid until the
  // next call.
  const LoggedReceipt* Received(const std::string& host, const Receipt& receipt, int64_t unix_ns);
  // Newest first, at most `limit`; 0 = all.
  std::vector<LoggedReceipt> Newest(size_t limit) const;

 private:
  struct Known {
    std::string host;
    std::string id;
    std::string text;
  };
  void MakeRoom(const LoggedReceipt& added);

  std::deque<Known> commands_;          // oldest first
  std::deque<LoggedReceipt> receipts_;  // oldest first
};

// `level ALERT`, ...
std::string CommandText(const Command& command);

// `text` of a robot with every byte outside printable ASCII as \xNN, cut to `bytes_max` with `...`.
std::string Harmless(absl::string_view text, size_t bytes_max);

// A receipt of harmless texts and `bytes_max` at most; outputs stay bytes.
Receipt Trimmed(const Receipt& receipt, size_t bytes_max = kReceiptBytesKept);

// `program horn: exit code 1; ...` of the steps that failed, or else the receipt's detail;
// harmless, cut to kDetailBytesKept.
std::string FailureText(const Receipt& receipt);

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_ACTUATORS_RECEIPT_HISTORY_H_
