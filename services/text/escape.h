// Hostile text, made harmless for a terminal.
#ifndef RIPS_SERVICES_TEXT_ESCAPE_H_
#define RIPS_SERVICES_TEXT_ESCAPE_H_

#include <string>

#include "absl/strings/string_view.h"

namespace rips {

// `text` as it may be shown on a terminal, on one line. Becomes \xHH: control characters, bytes
// that are not UTF-8. Becomes \uHHHH: C1 controls, line and paragraph separators, and characters
// that are invisible or turn the direction of writing (they make text look like other text).
std::string EscapeText(absl::string_view text);

}  // namespace rips

#endif  // RIPS_SERVICES_TEXT_ESCAPE_H_
