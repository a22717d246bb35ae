// What each level means on this robot, as actuator.yaml says.
#ifndef RIPS_MODE_ACTUATOR_LEVEL_PLAN_H_
#define RIPS_MODE_ACTUATOR_LEVEL_PLAN_H_

#include <string>
#include <variant>
#include <vector>

#include "absl/time/time.h"

namespace rips::actuator {

// | on_failure | later steps, entering on a raise | the level                             |
// |------------|----------------------------------|---------------------------------------|
// | fail       | are run                          | failed                                |
// | continue   | are run                          | a program: reached all the same; a    |
// |            |                                  | system mode: failed, it was not read  |
// | stop       | are not run                      | failed                                |
// `fail` is the default. On a lowering a failed step always stops, except a program with
// `continue`.
enum class OnFailure { kFail, kContinue, kStop };

struct SystemModeStep {
  std::string part;  // absolute: `/safety`
  std::string mode;
  friend bool operator==(const SystemModeStep&, const SystemModeStep&) = default;
};

struct ProgramStep {
  std::string name;  // in the allow-list
  std::vector<std::string> args;
  friend bool operator==(const ProgramStep&, const ProgramStep&) = default;
};

struct Step {
  std::variant<SystemModeStep, ProgramStep> what;
  absl::Duration timeout;  // of one attempt
  int retries = 0;         // attempts after the first
  OnFailure on_failure = OnFailure::kFail;
};

struct LevelSpec {
  std::string name;
  std::vector<Step> enter;
  std::vector<Step> leave;
};

struct ProgramSpec {
  std::string name;
  std::string path;
  absl::Duration timeout = absl::Seconds(10);
  int concurrency = 1;  // runs at the same time, level steps included
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_LEVEL_PLAN_H_
