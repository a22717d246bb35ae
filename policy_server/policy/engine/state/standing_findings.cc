#include "policy_server/policy/engine/state/standing_findings.h"

#include <algorithm>
#include <cstddef>
#include <span>

#include "policy_server/policy/lang/check/signature.h"
#include "services/base/check.h"

namespace rips::engine {
namespace {

std::span<const absl::string_view> KindsOfRules() {
  return lang::SignatureOf(lang::Builtin::kFinding).parameters[0].words;
}

}  // namespace

uint16_t StandingFindings::BitOf(absl::string_view kind) {
  const auto kinds = KindsOfRules();
  RIPS_CHECK(kinds.size() <= 14, "more kinds of findings than there are bits");
  const auto found = std::find(kinds.begin(), kinds.end(), kind);
  if (found == kinds.end()) return kOtherBit;
  return static_cast<uint16_t>(1 << (found - kinds.begin()));
}

void StandingFindings::Add(absl::string_view kind) { bits_ |= BitOf(kind); }

std::optional<bool> StandingFindings::Stands(absl::string_view kind) const {
  const auto asked = static_cast<uint16_t>(kind == kAny ? ~kToldAll : BitOf(kind));
  if ((bits_ & asked) != 0) return true;
  if (told_all()) return false;
  return std::nullopt;
}

std::vector<absl::string_view> StandingFindings::Kinds() const {
  std::vector<absl::string_view> out;
  for (const absl::string_view kind : KindsOfRules()) {
    if ((bits_ & BitOf(kind)) != 0) out.push_back(kind);
  }
  if ((bits_ & kOtherBit) != 0) out.push_back(kOther);
  return out;
}

}  // namespace rips::engine
