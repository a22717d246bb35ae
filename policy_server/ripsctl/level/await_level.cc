#include "policy_server/ripsctl/level/await_level.h"

#include <nlohmann/json.hpp>
#include <ostream>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/robot_level.h"

namespace rips::ripsctl {
namespace {

constexpr absl::Duration kWaitMax = absl::Seconds(30);
// Well below the quota of queries, also if a colleague waits, too.
constexpr absl::Duration kWaitPoll = absl::Milliseconds(500);

}  // namespace

Awaited AwaitReached(Env& env, const std::string& robot, const v1::LevelResponse& decided) {
  if (!env.json()) {
    env.out << "waiting for the robot to reach it, for at most " << absl::FormatDuration(kWaitMax)
            << "; Ctrl-C stops the wait, not the decision" << std::endl;
  }
  const absl::Time end = absl::Now() + kWaitMax;
  std::string why;
  do {
    const auto seen = ReadLevel(env, robot);
    if (seen.ok()) {
      const v1::RobotStatus& status = seen->status();
      if (DecisionIdText(status.decision_id()) != DecisionIdText(decided.decision_id())) {
        // The newest that is recorded may be an older one.
        const std::string newest = DecisionIdText(status.decision_id());
        const bool known = DecisionIdText(seen->last().decision_id()) == newest;
        return {.why = absl::StrCat(
                    "a newer decision has replaced this one: ", status.decided_level(), " (",
                    newest, ")", known ? ", " : "", known ? seen->last().cause() : "")};
      }
      if (status.stage() == "verified") {
        return {.reached = true,
                .level = status.effective_level(),
                .degraded = {status.degraded().begin(), status.degraded().end()}};
      }
      why = absl::StrCat(status.stage(), status.degraded().empty() ? "" : ": ",
                         absl::StrJoin(status.degraded(), "; "));
    } else {
      why = std::string(seen.status().message());
      const absl::Status& status = seen.status();
      const bool passes = absl::IsUnavailable(status) || absl::IsDeadlineExceeded(status) ||
                          absl::IsResourceExhausted(status);
      if (!passes) return {.why = why};
    }
    absl::SleepFor(kWaitPoll);
  } while (absl::Now() < end);
  return {.why = absl::StrCat("not read back in ", absl::FormatDuration(kWaitMax), "; ", why,
                              "; the decision stands, and is tried again")};
}

void PrintAwaited(Env& env, const std::string& robot, const v1::LevelResponse& decided,
                  const Awaited& awaited) {
  if (awaited.reached) {
    env.out << robot << " is at " << EscapeText(awaited.level)
            << (awaited.level == decided.decided_level() ? "" : ", above the level decided")
            << ": every actuator has read it back\n";
    // Such as that another process uses the key of one.
    for (const std::string& why : awaited.degraded) {
      env.out << "degraded: " << EscapeText(why) << "\n";
    }
  } else {
    env.out << robot << " is not at " << EscapeText(decided.decided_level()) << ": "
            << EscapeText(awaited.why) << "\n";
  }
}

void AddAwaited(const Awaited& awaited, Json& json) {
  json["reached"] = awaited.reached;
  if (awaited.reached) json["effective_level"] = awaited.level;
  if (!awaited.reached) json["not_reached_because"] = awaited.why;
}

}  // namespace rips::ripsctl
