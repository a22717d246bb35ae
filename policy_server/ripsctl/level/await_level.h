// Whether a robot gets to the level that was decided: for `--wait`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_LEVEL_AWAIT_LEVEL_H_
#define RIPS_POLICY_SERVER_RIPSCTL_LEVEL_AWAIT_LEVEL_H_

#include <string>
#include <vector>

#include "policy_server/ripsctl/cli/env.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "rips/v1/operator.pb.h"

namespace rips::ripsctl {

// What a wait came to; `why` if the robot is not there.
struct Awaited {
  bool reached = false;
  // That the actuators hold; may be above the one decided.
  std::string level;
  std::string why;
  // Of a robot that is there.
  std::vector<std::string> degraded;
};

// Waits for at most 30 s, asking twice a second. What failed is tried again by the server, so that
// only a newer decision, a refusal or the time ends the wait. Says first that it waits, if the
// output is text.
Awaited AwaitReached(Env& env, const std::string& robot, const v1::LevelResponse& decided);
void PrintAwaited(Env& env, const std::string& robot, const v1::LevelResponse& decided,
                  const Awaited& awaited);
void AddAwaited(const Awaited& awaited, Json& json);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_LEVEL_AWAIT_LEVEL_H_
