// Cuts text to a number of bytes, between two characters of UTF-8. Pure; any bytes may come.
#ifndef RIPS_SERVICES_BASE_CUT_TEXT_H_
#define RIPS_SERVICES_BASE_CUT_TEXT_H_

#include <cstddef>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"

namespace rips {

// The longest start of `text` of at most `bytes_max` bytes that ends between two characters. Views
// `text`.
inline absl::string_view CutUtf8(absl::string_view text, size_t bytes_max) {
  if (text.size() <= bytes_max) return text;
  // A byte 10xxxxxx goes on with a character, which has three of them at most.
  size_t end = bytes_max;
  const auto inside = [&] { return (static_cast<unsigned char>(text[end]) & 0xC0) == 0x80; };
  while (end > 0 && bytes_max - end < 3 && inside()) --end;
  return text.substr(0, inside() ? bytes_max : end);
}

// `text`, or its start and `...`, at most `bytes_max` bytes in all; bytes_max is at least 3.
inline std::string Shortened(absl::string_view text, size_t bytes_max) {
  if (text.size() <= bytes_max) return std::string(text);
  return absl::StrCat(CutUtf8(text, bytes_max - 3), "...");
}

}  // namespace rips

#endif  // RIPS_SERVICES_BASE_CUT_TEXT_H_
