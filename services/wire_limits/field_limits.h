// How long each field of what a peer sends may be (field_limits.def), and the one check of it.
//
// A receiver refuses a message with a field past its limit before it keeps anything of it. A sender
// of ours cuts texts and caps counts before it sends, so it is never refused.
#ifndef RIPS_SERVICES_WIRE_LIMITS_FIELD_LIMITS_H_
#define RIPS_SERVICES_WIRE_LIMITS_FIELD_LIMITS_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/types/span.h"
#include "google/protobuf/message.h"

namespace rips::wire_limits {

// Nanoseconds, 146 years: of a boottime and of a Unix time. Two of them still add up in 64 bits.
inline constexpr uint64_t kTimeMax = (uint64_t{1} << 62) - 1;
inline constexpr uint64_t kSequenceMax = uint64_t{1} << 62;
// Observations of one Loss record: a million a second for twelve days.
inline constexpr uint64_t kLossCountMax = uint64_t{1} << 40;

struct FieldLimit {
  // `Message.field` of package rips.v1.
  const char* field;
  // Elements of a repeated field; 1 otherwise.
  uint32_t elements_max;
  // Bytes of a string or bytes, of each element; the largest value of a number. Numbers with a sign
  // are not below 0, unless this is kAnyValue.
  uint64_t value_max;
  // Our senders cut the text, or send `value_max` for more.
  bool cut_by_sender;
};
inline constexpr uint64_t kAnyValue = UINT64_MAX;
// The row for fields that this version does not know. A newer peer may send some; what they cost to
// parse is more than what is done with the message, so a message may not have many.
inline constexpr char kUnknownFields[] = "(unknown)";
// In one message, those in its unknown groups among them; in the messages in it as many again.
inline constexpr uint32_t kUnknownFieldsMax = 8;
// The row for what a whole message takes in memory (parsed_size.h). Three times the largest graph
// that our sensors send.
inline constexpr char kParsedSize[] = "(parsed size)";
inline constexpr size_t kParsedBytesMax = size_t{64} << 20;

// All rows. Valid for ever.
absl::Span<const FieldLimit> FieldLimits();

// A field past its limit.
struct LimitHit {
  // Index into FieldLimits().
  size_t row = 0;
  // Elements, bytes, or the number, as `what` says.
  uint64_t size = 0;
  enum class What { kElements, kBytes, kValue, kNegative } what = What::kBytes;

  const char* field() const;
  // `ActuatorHeartbeat.floor_reason has 4194304 bytes; at most 1024`. Never any content.
  std::string Text() const;
  // InvalidArgument with Text().
  absl::Status ToStatus() const;
};

// The first field of `message`, or of a message in it, that is past its limit; nullopt = none. A
// field without a row is not checked: the test sees to it that a peer cannot send one. Any thread;
// a MessageSeen costs some nanoseconds, the rest is walked by reflection.
std::optional<LimitHit> Check(const google::protobuf::Message& message);

// Of a message that has `bytes` bytes and would take more than kParsedBytesMax.
LimitHit ParsedSizeHit(size_t bytes);

// For senders: cuts texts (between two characters of UTF-8) and lists of texts, and caps counts.
// What means something to a program stays as it is.
void CutToLimits(google::protobuf::Message& message);

}  // namespace rips::wire_limits

#endif  // RIPS_SERVICES_WIRE_LIMITS_FIELD_LIMITS_H_
