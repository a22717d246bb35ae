// /etc/rips/actuator.yaml.
#ifndef RIPS_MODE_ACTUATOR_CONFIG_CONFIG_H_
#define RIPS_MODE_ACTUATOR_CONFIG_CONFIG_H_

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/alarm_state.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/firewall/firewall_config.h"
#include "mode_actuator/steps/port/part_modes.h"
#include "mode_actuator/steps/program/exec_config.h"
#include "mode_actuator/steps/system_mode/smh.h"
#include "services/model/receipt.h"
#include "services/runtime/config_sections.h"

namespace rips::actuator {

// The sum of timeout x (1 + retries) over the enter steps of one level: a level is a command that
// must be over in this time.
inline constexpr absl::Duration kLevelBudget = absl::Seconds(20);
inline constexpr size_t kLevelsMax = 64;
inline constexpr size_t kStepsMax = 64;  // of one list
inline constexpr size_t kProgramsMax = 256;
inline constexpr size_t kLevelNameBytesMax = 64;

struct Config {
  std::string robot;  // must equal the certificate
  std::string host;   // must equal the certificate
  std::vector<std::string> servers;
  TlsFiles tls;
  DdsSettings dds;
  std::string state_dir = "/var/lib/rips/actuator";
  // Taken when the lease is lost; `keep` = stay where it is. No default: the installer chooses.
  std::string fail_safe_level;
  absl::Duration fail_safe_after;  // counts from the end of the lease
  std::string smh_file;            // empty: no level has a system mode
  // `fallback` is kNone if only the mode manager is read back, unless the file says otherwise.
  ModesOptions modes;
  // Topics that nodes publish although the level has them inactive.
  std::vector<std::string> published_while_inactive;
  std::vector<AlarmSpec> devices;  // alarms
  std::vector<LevelSpec> levels;   // least restrictive first, as in the bundle
  std::vector<ProgramSpec> programs;
  std::string scripts;  // directory of level scripts (steps/program/level_scripts.h); empty: none
  ExecSettings exec;
  FirewallSettings firewall;
  absl::Duration floor_hold = absl::Seconds(10);  // live lease needed before a floor lifts
  absl::Duration reconcile = absl::Seconds(2);    // between two looks at the robot
  std::string metrics = "127.0.0.1:9466";         // empty: none
};

struct ParsedConfig {
  Config config;
  std::vector<ConfigSetting> settings;  // the effective configuration
};

// InvalidArgument with all problems, each with its place in the text.
absl::StatusOr<ParsedConfig> ParseConfig(absl::string_view file, absl::string_view text);

// Adds the level scripts of `config.scripts` to levels, programs and settings.
// InvalidArgument as AddLevelScripts, and if a level exceeds kLevelBudget with its script.
absl::Status AddScripts(ParsedConfig* parsed);

// Every (part, mode) of the levels once.
std::vector<std::pair<std::string, std::string>> ModeTargets(const std::vector<LevelSpec>& levels);

// Full names of the parts that only these steps control: those of the levels, then those of the SMH
// file, each once; no systems if the nodes are always ordered directly, since nothing on the robot
// need have such a name then. At most kProtectedPartsMax, which is logged; names that no ROS node
// can have are left out.
inline constexpr size_t kProtectedPartsMax = 256;
std::vector<std::string> ProtectedParts(const std::vector<LevelSpec>& levels, const Smh& smh,
                                        Backend backend);

// The nodes that each level has inactive once its steps have set their modes, by level; of `parts`
// alone. Not those that its on_drift steps have active. What CheckLevelsAgainstSmh refuses is left
// out.
std::vector<model::InactiveParts> InactiveParts(const std::vector<LevelSpec>& levels,
                                                const Smh& smh,
                                                const std::vector<std::string>& parts);

// InvalidArgument if a level names a part or mode that the SMH file does not have.
absl::Status CheckLevelsAgainstSmh(const Config& config, const Smh& smh);

// A line for each node that a level has active and the level before it has not, and for each that
// the last level has active just as the first has it.
std::vector<std::string> MonotonyWarnings(const Config& config, const Smh& smh);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_CONFIG_CONFIG_H_
