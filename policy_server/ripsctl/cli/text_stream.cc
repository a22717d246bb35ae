#include "policy_server/ripsctl/cli/text_stream.h"

#include "services/text/escape.h"

namespace rips::ripsctl {

const TextStream& TextStream::operator<<(absl::string_view text) const {
  *out_ << EscapeText(text);
  return *this;
}

const TextStream& TextStream::operator<<(Lines lines) const {
  absl::string_view rest = lines.text;
  while (!rest.empty()) {
    const size_t end = rest.find_first_of("\n\t");
    *out_ << EscapeText(rest.substr(0, end));
    if (end == absl::string_view::npos) break;
    *out_ << rest[end];
    rest.remove_prefix(end + 1);
  }
  return *this;
}

}  // namespace rips::ripsctl
