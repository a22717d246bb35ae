// The texts given to nft. Each is one transaction of the kernel: all of it or nothing. Each begins
// with the table itself, which leaves alone what is there: loading twice gives the same ruleset,
// and isolations keep their timers.
//
//   table inet rips, chains input, output, forward at priority -150 (after connection tracking,
//   before whatever the administrator has), policy accept:
//     loopback, and connections to policy servers    accept: nothing below reaches them; none that
//                                                    begins there
//     bad_guid, quarantine4/6, quarantine_mac        drop, until their time is over
//     neighbour discovery, path MTU                  accept: servers stay reachable
//     level_in, level_out, level_forward             the level's file, while level_hold has not run
//                                                    out
//     count_and_drop                                 where `drop` of what comes in ends: it counts,
//                                                    also by source address
// We can only restrict: `accept` here ends our own chain, not the administrator's.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_NFT_SCRIPT_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_NFT_SCRIPT_H_

#include <cstdint>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/firewall/fragment.h"
#include "mode_actuator/steps/firewall/target.h"

namespace rips::actuator {

// Source addresses of each family that are counted; packets of others are dropped all the same.
inline constexpr size_t kCountedSourcesMax = 256;
inline constexpr absl::Duration kCountedSourceKept = absl::Minutes(10);
// Elements of each set of isolated ones.
inline constexpr size_t kIsolatedMax = 256;
// Addresses and ports of policy servers.
inline constexpr size_t kControlMax = 64;

// One isolated target. `since_s`: CLOCK_BOOTTIME seconds when it began, kept beside the element so
// that it outlives us.
struct Isolation {
  Target target;
  absl::Duration hold_for;  // whole seconds, at least 1
  int64_t since_s = 0;
  friend bool operator==(const Isolation&, const Isolation&) = default;
};

// `quarantine4`, `bad_guid`, ...
absl::string_view SetOf(TargetKind kind);
// `level_in`, ...
absl::string_view LevelChainOf(Hook hook);
// What marks the `n`th rule (from 1) of a level as ours.
std::string RuleComment(size_t n);

// The table, its sets and its own chains.
std::string TableScript(const std::vector<ControlAddress>& control);
// The level's rules in place of those before, for `hold_for`.
std::string LevelScript(const std::vector<FragmentRule>& rules, absl::Duration hold_for);
// Only the time of the level's rules, anew.
std::string HoldScript(absl::Duration hold_for);
// Adds, or sets the time of those that are there.
std::string IsolateScript(const std::vector<Isolation>& isolations);
// No level rules; isolated are exactly `kept`.
std::string ReleaseScript(const std::vector<Isolation>& kept);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_NFT_SCRIPT_H_
