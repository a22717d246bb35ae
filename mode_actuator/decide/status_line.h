#ifndef RIPS_MODE_ACTUATOR_DECIDE_STATUS_LINE_H_
#define RIPS_MODE_ACTUATOR_DECIDE_STATUS_LINE_H_

#include <string>

#include "absl/status/status.h"
#include "mode_actuator/decide/level_actions.h"

namespace rips::actuator {

// For `systemctl status`: the level, then what is wrong. `disconnected`: why the last stream to a
// policy server ended, OK if there was none; its text may be a peer's, and is not escaped.
std::string StatusLine(const ExecutorReport& report, bool connected,
                       const absl::Status& disconnected);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_DECIDE_STATUS_LINE_H_
