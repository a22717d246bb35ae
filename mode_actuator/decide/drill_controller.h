// What becomes of the server's drill commands. Pure; one thread.
//
// | command (first line that fits)         | receipt                                             |
// |----------------------------------------|-----------------------------------------------------|
// | term below the highest seen            | REFUSED_STALE                                       |
// | id seen before                         | the newest one of that id                           |
// | a level that is none of ours           | REFUSED                                             |
// | another drill runs                     | REFUSED                                             |
// | a level is being applied               | REFUSED                                             |
// | else                                   | ACKNOWLEDGED, and when it is over                   |
// |                                        | VERIFIED if no step failed, SUPERSEDED if a level   |
// |                                        | had to be applied meanwhile, else FAILED            |
#ifndef RIPS_MODE_ACTUATOR_DECIDE_DRILL_CONTROLLER_H_
#define RIPS_MODE_ACTUATOR_DECIDE_DRILL_CONTROLLER_H_

#include <cstdint>
#include <deque>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "mode_actuator/decide/receipt.h"
#include "services/model/command.h"

namespace rips::actuator {

// Of drills, kept to answer duplicates; a drill that runs is among them.
inline constexpr size_t kDrillReceiptsMax = 16;
// Of a receipt's detail that names the steps that failed.
inline constexpr size_t kDrillDetailBytesMax = 1024;

struct DrillJob {
  std::string id;
  std::string level;  // whose steps are tried
  std::string held;   // the robot is held at
};

struct DrillOutcome {
  std::string id;
  bool cancelled = false;  // a level had to be applied
  std::vector<StepResult> steps;
};

class DrillController {
 public:
  explicit DrillController(std::vector<std::string> levels) : levels_(std::move(levels)) {}

  // `command` is a Drill; `admitted`: the term is not stale; `held`: the effective level. `begin`
  // starts the job, and gives false if a level is being applied.
  Receipt OnCommand(const model::Command& command, bool admitted, const std::string& held,
                    const std::function<bool(const DrillJob&)>& begin);
  Receipt OnOutcome(DrillOutcome outcome);

 private:
  Receipt Keep(Receipt receipt);

  const std::vector<std::string> levels_;
  std::string running_;           // id; empty = none
  std::deque<Receipt> receipts_;  // newest last; one per id
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_DRILL_CONTROLLER_H_
