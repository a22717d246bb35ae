#include "services/base/ids.h"

#include <sys/random.h>

#include <array>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "services/base/check.h"

namespace rips {
namespace {

constexpr size_t kNameLengthMax = 63;

bool IsNameChar(char c) { return absl::ascii_islower(c) || absl::ascii_isdigit(c); }

}  // namespace

bool IsValidName(absl::string_view name) {
  if (name.empty() || name.size() > kNameLengthMax) return false;
  if (!IsNameChar(name.front()) || !IsNameChar(name.back())) return false;
  for (char c : name) {
    if (!IsNameChar(c) && c != '-') return false;
  }
  return true;
}

absl::Status ValidateName(absl::string_view what, absl::string_view name) {
  if (IsValidName(name)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("`", absl::CHexEscape(name), "` is not a valid ", what,
                   "; use 1 to 63 of a-z, 0-9 and `-`, with no `-` at either end"));
}

std::string NewId() {
  std::array<char, 16> bytes;
  const ssize_t got = getrandom(bytes.data(), bytes.size(), 0);
  RIPS_CHECK(got == static_cast<ssize_t>(bytes.size()), "getrandom gave fewer bytes than asked");
  return absl::BytesToHexString(absl::string_view(bytes.data(), bytes.size()));
}

}  // namespace rips
