// That operators have seen alerts.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_ACK_STORE_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_ACK_STORE_H_

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/store/records.h"

namespace rips::store {

// Bytes of an acknowledgement's note.
inline constexpr size_t kAckNoteBytesMax = 1'000;

struct Ack {
  // Who acknowledged it, as rpc::Describe gives it.
  std::string by;
  // The operator's words: any bytes; may be empty.
  std::string note;
  // Above 0.
  int64_t time_unix_ns = 0;

  friend bool operator==(const Ack&, const Ack&) = default;
};

// The acknowledgement of one alert.
struct AckRecord {
  // Of the alert, 32 hex digits.
  std::string alert_id;
  Ack ack;
  // Of what Acknowledge returns: it was there before.
  bool already = false;

  friend bool operator==(const AckRecord&, const AckRecord&) = default;
};

// At most one acknowledgement of each alert that a Store keeps; it is forgotten with the alert.
// Durable when a method returns OK; errors as for Store.
class AckStore {
 public:
  virtual ~AckStore() = default;
  // All of these alerts or none. The acknowledgements that stand now, in the order of the ids: of
  // an alert that had one, the first. NotFound, naming it, if an alert is not kept; InvalidArgument
  // for what CheckAck refuses.
  virtual absl::StatusOr<std::vector<AckRecord>> Acknowledge(std::span<const std::string> alert_ids,
                                                             const Ack& ack) = 0;
  // Those that there are of these alerts, in the order of the ids.
  virtual absl::StatusOr<std::vector<AckRecord>> FindAcks(
      std::span<const std::string> alert_ids) = 0;
  // As Store::ListAlerts, without those that are acknowledged.
  virtual absl::StatusOr<std::vector<AlertRecord>> ListOpenAlerts(absl::string_view robot,
                                                                  uint32_t limit) = 0;
};

// InvalidArgument without `by` or a time above 0, or for a note beyond kAckNoteBytesMax. Shared by
// implementations.
absl::Status CheckAck(const Ack& ack);
// NotFound. Shared by implementations.
absl::Status NoSuchAlert(absl::string_view alert_id);

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_ACK_STORE_H_
