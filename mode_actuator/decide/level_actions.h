// What goes into LevelController and what comes out of it.
#ifndef RIPS_MODE_ACTUATOR_DECIDE_LEVEL_ACTIONS_H_
#define RIPS_MODE_ACTUATOR_DECIDE_LEVEL_ACTIONS_H_

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "mode_actuator/decide/actuator_state.h"
#include "mode_actuator/decide/drop_watch.h"
#include "mode_actuator/decide/receipt.h"
#include "services/base/decision_id.h"

namespace rips::actuator {

// --- inputs, besides commands and leases

enum class JobKind {
  kEnter,    // leave steps of `from`, enter steps of `to`
  kRetry,    // as the last kEnter, without the programs that have succeeded
  kCheck,    // only read back
  kOnDrift,  // the on_drift steps of `to`
  kSurvey,   // read back which level the robot shows, whatever it is
};

struct LevelOutcome {
  uint64_t attempt = 0;
  JobKind kind = JobKind::kEnter;
  bool reached = false;  // read back; of a survey: the robot shows a level
  std::vector<StepResult> steps;
  std::string detail;                // why not
  std::string observed;              // `/safety=ALERT`
  std::string shown;                 // of a survey: the level that the robot shows; empty = none
  std::optional<DropCount> dropped;  // of a check: StepReading::dropped
};

// --- actions

// Starts a job, after ending the running one if there is any.
struct ApplyLevel {
  uint64_t attempt = 0;
  JobKind kind = JobKind::kEnter;
  std::string from;  // empty after a start: nothing to leave
  std::string to;
  bool raise = true;
};
// Records `state`; answered by OnPersisted(sequence). In order; only the newest must survive.
struct PersistState {
  uint64_t sequence = 0;
  ActuatorState state;
};
struct SendReceipt {
  Receipt receipt;
};
using Action = std::variant<ApplyLevel, PersistState, SendReceipt>;
using Actions = std::vector<Action>;

// For Hello, heartbeat, logs and metrics.
struct ExecutorReport {
  DecisionId decision_id;
  std::string decided;  // empty: none
  std::string effective;
  uint64_t highest_term = 0;
  bool state_lost = false;
  bool verified = false;
  std::string observed;
  std::string floor;  // empty: none
  std::string floor_reason;
  bool lease_live = false;
  uint64_t drifts = 0;                // times a verified level was found left
  std::vector<std::string> degraded;  // faults that do not prevent the level
  friend bool operator==(const ExecutorReport&, const ExecutorReport&) = default;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_LEVEL_ACTIONS_H_
