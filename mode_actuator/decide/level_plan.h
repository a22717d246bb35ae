// What each level means on this robot, as actuator.yaml says.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_LEVEL_PLAN_H_
#define RIPS_MODE_ACTUATOR_DECIDE_LEVEL_PLAN_H_

#include <string>
#include <variant>
#include <vector>

#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/alarm_state.h"

namespace rips::actuator {

// | on_failure | later steps, entering on a raise | the level                             |
// |------------|----------------------------------|---------------------------------------|
// | fail       | are run                          | failed                                |
// | continue   | are run                          | a program or alarm: reached all the   |
// |            |                                  | same; any other: failed, it was not   |
// |            |                                  | read                                  |
// | stop       | are not run                      | failed                                |
// `fail` is the default. On a lowering a failed step always stops, except a program or alarm with
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
  bool level_args = false;  // the arguments are the level gone to and the level come from
  friend bool operator==(const ProgramStep&, const ProgramStep&) = default;
};

struct AlarmStep {
  std::string device;  // in `devices`
  AlarmState state;    // one that its kind has
  friend bool operator==(const AlarmStep&, const AlarmStep&) = default;
};

inline constexpr absl::Duration kFirewallForMax = absl::Hours(24);  // of hold_for

// What rips-fw is asked for. All but kRelease end by themselves after `hold_for`, in the kernel, so
// that a robot whose actuator is dead opens again; while the level holds, its check renews them.
struct FirewallStep {
  enum class Kind {
    kRules = 1,            // the rules of `file` take the place of any level's rules before
    kIsolateHosts,         // nothing to or from `targets`: IPv4, IPv6 or MAC addresses
    kIsolateParticipants,  // nothing from `targets`: GUID prefixes, 24 hexadecimal digits
    kRelease,              // ends all of the above
  };
  Kind kind = Kind::kRelease;
  std::string file;
  std::vector<std::string> targets;
  absl::Duration hold_for = absl::Minutes(10);
  friend bool operator==(const FirewallStep&, const FirewallStep&) = default;
};

struct Step {
  std::variant<SystemModeStep, ProgramStep, AlarmStep, FirewallStep> what;
  absl::Duration timeout;  // of one attempt
  int retries = 0;         // attempts after the first
  OnFailure on_failure = OnFailure::kFail;
};

struct LevelSpec {
  std::string name;
  std::vector<Step> enter;
  std::vector<Step> leave;
  // Run when the level was found left too often (drift_watch.h). A part whose mode they order stays
  // in it until a level is entered anew.
  std::vector<Step> on_drift;
};

// The one of that name; null if there is none.
template <typename T>
const T* FindNamed(const std::vector<T>& all, absl::string_view name) {
  for (const T& each : all) {
    if (each.name == name) return &each;
  }
  return nullptr;
}

// Calls `visit(step)` for each step of `levels`.
template <typename Visit>
void ForEachStep(const std::vector<LevelSpec>& levels, const Visit& visit) {
  for (const LevelSpec& level : levels) {
    for (const std::vector<Step>* steps : {&level.enter, &level.leave, &level.on_drift}) {
      for (const Step& step : *steps) visit(step);
    }
  }
}

struct ProgramSpec {
  std::string name;
  std::string path;
  absl::Duration timeout = absl::Seconds(10);
  int concurrency = 1;        // runs at the same time, level steps included
  int starts_per_minute = 0;  // 0 = no limit
  std::string sha256;         // of the file, 64 lower case hexadecimal digits; empty = not checked
  bool drill = false;         // may be run as a drill: it does nothing in earnest when RIPS_DRILL=1
  bool script = false;        // of the directory `scripts`: for its level alone, not for `exec`
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_LEVEL_PLAN_H_
