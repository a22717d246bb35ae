#include "policy_server/policy/lang/syntax/literal.h"

#include <cmath>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_format.h"
#include "services/text/utf8.h"

namespace rips::lang {
namespace {

constexpr std::pair<char, char> kSimpleEscapes[] = {
    {'a', '\a'}, {'b', '\b'}, {'f', '\f'},  {'n', '\n'}, {'r', '\r'},
    {'t', '\t'}, {'v', '\v'}, {'\\', '\\'}, {'"', '"'},
};

// Value of a digit in any base up to 16; 16 if it is none.
int DigitValue(char c) {
  if (absl::ascii_isdigit(c)) return c - '0';
  const char lower = absl::ascii_tolower(c);
  return lower >= 'a' && lower <= 'f' ? lower - 'a' + 10 : 16;
}

// Exactly `count` digits of `base` at the start of `text`.
std::optional<uint32_t> ReadDigits(absl::string_view text, size_t count, int base) {
  if (text.size() < count) return std::nullopt;
  uint32_t value = 0;
  for (size_t i = 0; i < count; ++i) {
    const int digit = DigitValue(text[i]);
    if (digit >= base) return std::nullopt;
    value = value * base + digit;
  }
  return value;
}

// Appends what the escape at the start of `text` (after the backslash) means. Returns the bytes
// taken, 0 if it means nothing.
size_t DecodeEscape(absl::string_view text, std::string* out) {
  if (text.empty()) return 0;
  for (const auto& [letter, byte] : kSimpleEscapes) {
    if (text[0] == letter) {
      out->push_back(byte);
      return 1;
    }
  }
  if (text[0] == 'x') {
    const auto value = ReadDigits(text.substr(1), 2, 16);
    if (!value) return 0;
    out->push_back(static_cast<char>(*value));
    return 3;
  }
  if (text[0] == 'u' || text[0] == 'U') {
    const size_t digits = text[0] == 'u' ? 4 : 8;
    const auto value = ReadDigits(text.substr(1), digits, 16);
    if (!value || !IsScalarValue(*value)) return 0;
    AppendUtf8(*value, out);
    return 1 + digits;
  }
  const auto octal = ReadDigits(text, 3, 8);
  if (!octal || *octal > 0xFF) return 0;
  out->push_back(static_cast<char>(*octal));
  return 3;
}

// The escape at the start of `text` (the backslash) as far as it looks like one.
std::string SpellEscape(absl::string_view text) {
  if (text.size() < 2) return std::string(text);
  size_t length = 1 + DecodeCodePoint(text, 1).length;
  const char letter = text[1];
  size_t digits = 0;
  if (letter == 'x' || absl::ascii_isdigit(letter)) digits = 2;
  if (letter == 'u') digits = 4;
  if (letter == 'U') digits = 8;
  while (digits-- > 0 && length < text.size() && DigitValue(text[length]) < 16) ++length;
  return std::string(text.substr(0, length));
}

}  // namespace

StringValue DecodeString(absl::string_view text) {
  StringValue out;
  absl::string_view rest = text.substr(1, text.size() - 2);
  while (!rest.empty()) {
    if (rest[0] != '\\') {
      out.value.push_back(rest[0]);
      rest.remove_prefix(1);
      continue;
    }
    const size_t taken = DecodeEscape(rest.substr(1), &out.value);
    if (taken == 0 && out.bad_escape.empty()) out.bad_escape = SpellEscape(rest);
    rest.remove_prefix(1 + taken);
  }
  return out;
}

std::string EncodeString(absl::string_view value) {
  std::string out = "\"";
  for (size_t offset = 0; offset < value.size();) {
    const CodePoint point = DecodeCodePoint(value, offset);
    if (!point.valid || IsControl(point.value)) {
      for (size_t i = 0; i < point.length; ++i) {
        absl::StrAppendFormat(&out, "\\x%02x", static_cast<uint8_t>(value[offset + i]));
      }
    } else {
      if (point.value == '"' || point.value == '\\') out.push_back('\\');
      AppendUtf8(point.value, &out);
    }
    offset += point.length;
  }
  return out + "\"";
}

IntegerValue DecodeInteger(absl::string_view text) {
  int base = 10;
  if (text.size() >= 2 && text[0] == '0' && !absl::ascii_isdigit(text[1])) {
    base = text[1] == 'x' ? 16 : text[1] == 'o' ? 8 : text[1] == 'b' ? 2 : 0;
    text.remove_prefix(2);
  }
  if (base == 0 || text.empty()) return {.error = NumberError::kMalformed};
  IntegerValue out;
  for (const char c : text) {
    const int digit = DigitValue(c);
    if (digit >= base) return {.error = NumberError::kMalformed};
    if (out.magnitude > (kMinIntMagnitude - digit) / base) out.error = NumberError::kOutOfRange;
    out.magnitude = out.magnitude * base + digit;
  }
  return out;
}

FloatValue DecodeFloat(absl::string_view text) {
  FloatValue out;
  if (!absl::SimpleAtod(text, &out.value)) return {.error = NumberError::kMalformed};
  if (std::isinf(out.value)) out.error = NumberError::kOutOfRange;
  return out;
}

}  // namespace rips::lang
