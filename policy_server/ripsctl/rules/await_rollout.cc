#include "policy_server/ripsctl/rules/await_rollout.h"

#include <ostream>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/time/clock.h"
#include "policy_server/ripsctl/cli/command.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/rules/rollout_text.h"

namespace rips::ripsctl {
namespace {

constexpr absl::Duration kPoll = absl::Seconds(1);

// What may be over by itself; a refusal is not. A server that stops cancels what it has not
// answered.
bool MayPass(const absl::Status& status) {
  return absl::IsUnavailable(status) || absl::IsCancelled(status) ||
         absl::IsDeadlineExceeded(status) || absl::IsResourceExhausted(status);
}

}  // namespace

absl::StatusOr<v1::Rollout> AwaitRollout(Env& env, const v1::Rollout& begun) {
  std::string printed;
  absl::Duration lost;
  while (true) {
    const absl::Time asked = absl::Now();
    const auto status = Call(env, &Stub::GetRulesStatus, v1::GetRulesStatusRequest());
    if (!status.ok()) {
      if (!MayPass(status.status()) || lost > kAwaitLost) return status.status();
      if (lost == absl::ZeroDuration()) {
        env.err << ShortTime(absl::GetCurrentTimeNanos()) << "  the server does not answer ("
                << EscapeText(status.status().message())
                << "); the roll-out is its own, trying again" << std::endl;
      }
      lost += kPoll + (absl::Now() - asked);
      env.sleep(kPoll);
      continue;
    }
    if (std::exchange(lost, absl::ZeroDuration()) > absl::ZeroDuration()) {
      env.err << ShortTime(absl::GetCurrentTimeNanos()) << "  the server answers again"
              << std::endl;
    }
    const v1::Rollout& now = status->rollout();
    if (now.id() != begun.id()) {
      return absl::AbortedError(
          "another roll-out has begun since; how this one ended is in `ripsctl alert list "
          "'(server)'`");
    }
    const std::string progress = RolloutProgress(now);
    if (!env.json() && progress != printed) {
      env.out << ShortTime(absl::GetCurrentTimeNanos()) << "  " << EscapeText(progress)
              << std::endl;
      printed = progress;
    }
    if (now.state() != "running" || !env.out.ok()) return now;
    env.sleep(kPoll);
  }
}

}  // namespace rips::ripsctl
