// Text that may hold anything, for a message.
#ifndef RIPS_SERVICES_TEXT_QUOTE_H_
#define RIPS_SERVICES_TEXT_QUOTE_H_

#include <cstddef>
#include <string>

#include "absl/strings/string_view.h"

namespace rips {

// Between backticks, at most 64 code points, controls and bytes that are not UTF-8 as U+FFFD.
std::string Quote(absl::string_view text);

// Between backticks, at most 256 bytes, all but printable ASCII as C escapes: for paths and names,
// of which each byte counts.
std::string QuoteBytes(absl::string_view text);

}  // namespace rips

#endif  // RIPS_SERVICES_TEXT_QUOTE_H_
