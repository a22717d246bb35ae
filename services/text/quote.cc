#include "services/text/quote.h"

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/text/utf8.h"

namespace rips {
namespace {

constexpr size_t kQuotedCodePointsMax = 64;
constexpr size_t kQuotedBytesMax = 256;

}  // namespace

std::string Quote(absl::string_view text) {
  std::string out = "`";
  size_t count = 0;
  for (size_t offset = 0; offset < text.size(); ++count) {
    if (count == kQuotedCodePointsMax) {
      out += "...";
      break;
    }
    const CodePoint point = DecodeCodePoint(text, offset);
    AppendUtf8(IsControl(point.value) ? kReplacementCharacter : point.value, &out);
    offset += point.length;
  }
  return out + "`";
}

std::string QuoteBytes(absl::string_view text) {
  return absl::StrCat("`", absl::CHexEscape(text.substr(0, kQuotedBytesMax)), "`");
}

}  // namespace rips
