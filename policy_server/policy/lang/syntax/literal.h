// What literals mean.
#ifndef RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_LITERAL_H_
#define RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_LITERAL_H_

#include <cstdint>
#include <optional>
#include <string>

#include "absl/strings/string_view.h"

namespace rips::lang {

// Magnitude of the smallest integer; a literal this large is legal only right after a minus.
inline constexpr uint64_t kMinIntMagnitude = uint64_t{1} << 63;

struct StringValue {
  // May hold bytes that are not UTF-8 (`\xFF`).
  std::string value;
  // The first escape that means nothing, as written; empty if all are good.
  std::string bad_escape;
};

// `text` is the token with its quotes. Escapes: \a \b \f \n \r \t \v \\ \" \xHH \ooo (three digits,
// at most \377) \uHHHH \UHHHHHHHH (no surrogates, at most 10FFFF).
StringValue DecodeString(absl::string_view text);

// The reverse: a literal that decodes to `value`, all ASCII but for valid printable UTF-8.
std::string EncodeString(absl::string_view value);

enum class NumberError { kMalformed, kOutOfRange };

struct IntegerValue {
  uint64_t magnitude = 0;
  std::optional<NumberError> error;
};

// Decimal (leading zeros mean nothing), 0x, 0o, 0b. Up to kMinIntMagnitude.
IntegerValue DecodeInteger(absl::string_view text);

struct FloatValue {
  double value = 0;
  std::optional<NumberError> error;
};

// Too large is out of range; too small rounds to zero.
FloatValue DecodeFloat(absl::string_view text);

}  // namespace rips::lang

#endif  // RIPS_POLICY_SERVER_POLICY_LANG_SYNTAX_LITERAL_H_
