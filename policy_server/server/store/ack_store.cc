#include "policy_server/server/store/ack_store.h"

#include "absl/strings/str_cat.h"

namespace rips::store {

absl::Status CheckAck(const Ack& ack) {
  if (ack.by.empty() || ack.time_unix_ns <= 0) {
    return absl::InvalidArgumentError("an acknowledgement needs an operator and a time");
  }
  if (ack.note.size() <= kAckNoteBytesMax) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("note of ", ack.note.size(), " bytes, limit ", kAckNoteBytesMax));
}

absl::Status NoSuchAlert(absl::string_view alert_id) {
  return absl::NotFoundError(
      absl::StrCat("no alert with the id ", alert_id, " is kept; none was acknowledged"));
}

}  // namespace rips::store
