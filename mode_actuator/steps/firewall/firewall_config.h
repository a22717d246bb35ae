// What actuator.yaml says about the firewall.
#ifndef RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FIREWALL_CONFIG_H_
#define RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FIREWALL_CONFIG_H_

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/firewall/fragment.h"
#include "services/base/config_setting.h"
#include "services/runtime/config_reader.h"

namespace rips::actuator {

// DDS leases end after 10 s mostly, and discovery reports it a little later.
inline constexpr absl::Duration kFirewallHoldMin = absl::Seconds(12);
inline constexpr absl::Duration kFirewallHoldMax = absl::Minutes(10);
// Of one firewall step: nft is run up to four times.
inline constexpr absl::Duration kFirewallStepTimeout = absl::Seconds(2);
inline constexpr int kFirewallStepRetries = 1;

struct FirewallSettings {
  std::string socket = "/run/rips/fw.sock";  // where rips-fw listens
  std::string user = "rips";                 // who may ask it, besides root; a name or a number
  std::string run_as;                        // its user; empty = `rips-fw`, if it exists
  absl::Duration hold = kFirewallHoldMin;    // FirewallOptions::hold
};

// The section `firewall` of the file.
FirewallSettings ReadFirewall(const ConfigSection& root);

// The body of a `firewall` step: one of `file`, `isolate_host`, `isolate_participant` and
// `release: all`. Problems are reported in `body`. `servers` as in actuator.yaml.
FirewallStep ReadFirewallStep(const ConfigSection& body, const FirewallSettings& settings,
                              const std::vector<std::string>& servers);

// Reports what contradicts itself in one list of steps.
void CheckFirewallSteps(const ConfigSection& level, const std::string& key,
                        const std::vector<Step>& steps);

bool HasFirewallSteps(const std::vector<LevelSpec>& levels);
// A line for each level whose firewall outlives it at the lowest one: neither its `leave` nor the
// lowest level's `enter` releases it.
std::vector<std::string> FirewallWarnings(const std::vector<LevelSpec>& levels);
// The files of all steps, each once.
std::vector<std::string> FirewallFiles(const std::vector<LevelSpec>& levels);
// Reads them all: what is wrong with the first that is wrong (ReadFragment), after the line of the
// configuration that names it. `settings` are those of ParsedConfig.
absl::Status CheckFirewallFiles(const std::vector<LevelSpec>& levels,
                                const std::vector<ConfigSetting>& settings);

// The rules of the file of a `firewall: {file: ...}` step. PermissionDenied unless `path` is a
// regular file, no symbolic link, that root or our own user owns and no other user can write;
// NotFound, Unavailable; InvalidArgument as ParseFragment.
absl::StatusOr<std::vector<FragmentRule>> ReadFragment(const std::string& path);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_FIREWALL_FIREWALL_CONFIG_H_
