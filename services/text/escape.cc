#include "services/text/escape.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "services/text/utf8.h"

namespace rips {
namespace {

bool IsDeceptive(uint32_t code) {
  constexpr std::pair<uint32_t, uint32_t> kRanges[] = {
      {0x80, 0x9f},     {0xad, 0xad},     {0x61c, 0x61c},   {0x200b, 0x200f},  {0x2028, 0x202e},
      {0x2060, 0x206f}, {0xfeff, 0xfeff}, {0xfff9, 0xfffb}, {0xe0000, 0xe007f}};
  return std::any_of(std::begin(kRanges), std::end(kRanges), [code](const auto& range) {
    return code >= range.first && code <= range.second;
  });
}

}  // namespace

std::string EscapeText(absl::string_view text) {
  std::string out;
  for (size_t at = 0; at < text.size();) {
    const CodePoint point = DecodeCodePoint(text, at);
    if (!point.valid || point.value < 0x20 || point.value == 0x7f) {
      absl::StrAppendFormat(&out, "\\x%02x", static_cast<unsigned char>(text[at]));
    } else if (IsDeceptive(point.value)) {
      absl::StrAppendFormat(&out, "\\u%04x", static_cast<uint32_t>(point.value));
    } else {
      absl::StrAppend(&out, text.substr(at, point.length));
    }
    at += point.length;
  }
  return out;
}

}  // namespace rips
