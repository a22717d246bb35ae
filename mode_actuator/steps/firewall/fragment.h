// The file of a `firewall: {file: ...}` step: rules of nftables for the traffic of a level.
//
//   # Only the base station may speak DDS to us.
//   chain input {
//     udp dport 7400-65535 ip saddr != 10.0.0.2 counter drop
//   }
//   chain output {
//     ip daddr != 10.0.0.0/24 drop
//   }
//
// Chains are `input`, `output` and `forward`; each line inside is one rule as nft takes it. The
// rules go into chains of our own and nowhere else: a rule is always written behind
// `add rule inet rips level_...`, and what could end that command, or reach another chain or set
// from it, is refused here. What nft itself does not understand, its dry run refuses.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FRAGMENT_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FRAGMENT_H_

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::actuator {

inline constexpr size_t kFragmentBytesMax = 64 << 10;
inline constexpr size_t kFragmentRulesMax = 256;
inline constexpr size_t kFragmentLineBytesMax = 1024;

enum class Hook { kInput, kOutput, kForward };

struct FragmentRule {
  Hook hook = Hook::kInput;
  std::string text;
  int line = 0;  // from 1
  friend bool operator==(const FragmentRule&, const FragmentRule&) = default;
};

// InvalidArgument with `file:line: why` for the first mistake. A file without any rule is one, too.
absl::StatusOr<std::vector<FragmentRule>> ParseFragment(absl::string_view file,
                                                        absl::string_view text);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FRAGMENT_H_
