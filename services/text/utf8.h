// UTF-8, one code point at a time (RFC 3629: no surrogates, no overlong forms, <= U+10FFFF).
#ifndef RIPS_SERVICES_TEXT_UTF8_H_
#define RIPS_SERVICES_TEXT_UTF8_H_

#include <cstddef>
#include <optional>
#include <string>

#include "absl/strings/string_view.h"

namespace rips {

inline constexpr char32_t kReplacementCharacter = 0xFFFD;

struct CodePoint {
  // kReplacementCharacter when not valid.
  char32_t value = kReplacementCharacter;
  // Bytes taken: 1 when not valid, so that bad bytes count one each.
  size_t length = 1;
  bool valid = false;
};

// The code point that starts at byte `offset`, which must be < text.size().
CodePoint DecodeCodePoint(absl::string_view text, size_t offset);

// Byte offset of the first byte that is not UTF-8; none if the text is valid.
std::optional<size_t> FindInvalidUtf8(absl::string_view text);

// Number of code points; each byte that is not UTF-8 counts one.
size_t CountCodePoints(absl::string_view text);

// The longest start of `text` of at most `max` code points; each byte that is not UTF-8 counts one.
absl::string_view CutCodePoints(absl::string_view text, size_t max);

bool IsScalarValue(char32_t value);

// Appends `value`, which must be a scalar value.
void AppendUtf8(char32_t value, std::string* out);

// C0 and C1 controls and DEL, which must not reach a terminal.
bool IsControl(char32_t value);

}  // namespace rips

#endif  // RIPS_SERVICES_TEXT_UTF8_H_
