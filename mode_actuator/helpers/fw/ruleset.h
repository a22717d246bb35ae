// Our table as the kernel has it, read from nft's JSON.
#ifndef RIPS_MODE_ACTUATOR_HELPERS_FW_RULESET_H_
#define RIPS_MODE_ACTUATOR_HELPERS_FW_RULESET_H_

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace rips::actuator {

inline constexpr size_t kRulesetBytesMax = 4 << 20;

struct SetElement {
  std::string value;      // as Target::text; `10.0.0.1 . 7443`
  int64_t expires_s = 0;  // seconds left; 0 = no time limit, or less than a second
  int64_t since_s = 0;    // Isolation::since_s; 0 = not known
  uint64_t packets = 0;   // of its counter
  friend bool operator==(const SetElement&, const SetElement&) = default;
};

// Two equal views filter alike. Counters, handles and elements of sets are left out.
struct ChainView {
  std::string base;                   // type, hook, priority and policy; empty: no base chain
  std::vector<std::string> rules;     // in order
  std::vector<std::string> comments;  // of `rules`; empty = none
  friend bool operator==(const ChainView&, const ChainView&) = default;
};

struct Ruleset {
  bool present = false;
  bool dormant = false;  // there, but with flags: switched off by another process
  absl::btree_map<std::string, ChainView> chains;
  absl::btree_map<std::string, std::vector<SetElement>> sets;
  // Packets of counter `dropped`, since the table was made; absent: there is none.
  std::optional<uint64_t> dropped;
};

// `json` is what `nft -j list table inet rips` prints. DataLoss if it is nothing of the kind; also,
// with nft 1.0.6, for some tables that are switched off.
absl::StatusOr<Ruleset> ParseRuleset(absl::string_view json);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_HELPERS_FW_RULESET_H_
