// The directory of level scripts: `L.from` is run when level L is left, `L.to` when it is entered,
// both with the arguments TO FROM, the level gone to and the level come from; after a start of the
// actuator FROM is empty.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PROGRAM_LEVEL_SCRIPTS_H_
#define RIPS_MODE_ACTUATOR_STEPS_PROGRAM_LEVEL_SCRIPTS_H_

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/level_plan.h"
#include "services/base/config_setting.h"

namespace rips::actuator {

// Of one script.
inline constexpr absl::Duration kScriptTimeout = absl::Seconds(5);
// Files of the directory; each level has two at most, and there are 64 levels.
inline constexpr size_t kScriptFilesMax = 256;

// Adds what is in `directory` to `levels`, as one more step at the end of `leave` or `enter`, to
// `programs`, named as the file, and to `*settings`, its source the script with what it is given.
// Files whose names begin with a dot, and those that end with `~`, are passed over. InvalidArgument
// with all problems, one a line: a file that is no level's, one that could not be run
// (CheckProgramPath), a name that a program has already.
absl::Status AddLevelScripts(const std::string& directory, std::vector<LevelSpec>* levels,
                             std::vector<ProgramSpec>* programs,
                             std::vector<ConfigSetting>* settings);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PROGRAM_LEVEL_SCRIPTS_H_
