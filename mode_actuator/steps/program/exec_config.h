// What actuator.yaml says about rips-exec, and about limits of programs.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_CONFIG_H_
#define RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_CONFIG_H_

#include <string>

#include "mode_actuator/decide/level_plan.h"
#include "services/runtime/config_reader.h"

namespace rips::actuator {

inline constexpr int kStartsPerMinuteMax = 600;

struct ExecSettings {
  std::string socket = "/run/rips/exec.sock";  // where rips-exec listens
  std::string user = "rips";                   // who may ask it, besides root; a name or a number
  std::string run_as;  // its user; empty = `rips-exec`, if there is such a user
  std::string cgroup;  // directory of a cgroup v2 delegated to it; empty = its own
};

// The section `exec` of the file.
ExecSettings ReadExec(const ConfigSection& root);

// `rate`, `sha256` and `drill`, and the length of the name, of one entry of `programs`.
void ReadProgramGuards(const ConfigSection& section, ProgramSpec* program);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_CONFIG_H_
