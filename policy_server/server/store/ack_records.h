// That operators have seen alerts.
#ifndef RIPS_POLICY_SERVER_SERVER_STORE_ACK_RECORDS_H_
#define RIPS_POLICY_SERVER_SERVER_STORE_ACK_RECORDS_H_

#include <cstddef>
#include <cstdint>
#include <string>

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
  // Of the alert, for the audit log: no store keeps them here.
  std::string robot = {};
  std::string rule = {};
  std::string severity = {};

  friend bool operator==(const AckRecord&, const AckRecord&) = default;
};

}  // namespace rips::store

#endif  // RIPS_POLICY_SERVER_SERVER_STORE_ACK_RECORDS_H_
