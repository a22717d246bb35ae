#include "policy_server/server/outputs/gap.h"

#include <openssl/evp.h>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"

namespace rips::outputs {
namespace {

// 32 hex digits of `text`.
std::string IdOf(const std::string& text) {
  constexpr size_t kIdBytes = 16;
  unsigned char digest[EVP_MAX_MD_SIZE] = {};
  EVP_Digest(text.data(), text.size(), digest, nullptr, EVP_sha256(), nullptr);
  return absl::BytesToHexString(absl::string_view(reinterpret_cast<const char*>(digest), kIdBytes));
}

}  // namespace

store::AlertRecord MakeGapEvent(absl::string_view output, const Gap& gap, int64_t now_unix_ns) {
  std::string text;
  if (gap.count == 0) {
    text = "alerts may be missing here: the store does not know the alert that was sent last";
  } else {
    text = absl::StrCat(gap.count, gap.count == 1 ? " alert is" : " alerts are",
                        " missing here, of any robot and severity: the store forgot them by its "
                        "limit before they were sent");
  }
  absl::StrAppend(&text, "; the alert file has what was raised (output `", output, "`)");
  return {
      .id = IdOf(absl::StrCat("rips gap ", output, " ", gap.after, " ", gap.up_to, " ", gap.count)),
      .time_unix_ns = now_unix_ns,
      .robot = std::string(store::kServerRobot),
      .rule = "(rips)",
      .severity = "high",
      .text = text,
      .event = "gap"};
}

uint64_t CountForgotten(const store::AlertPage& page, uint64_t sequence) {
  if (!page.forgotten) return 0;
  return page.alerts.back().sequence - sequence - page.alerts.size();
}

}  // namespace rips::outputs
