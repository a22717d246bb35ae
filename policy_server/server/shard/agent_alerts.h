// What a robot's operators hear when one of its agents sends what none of ours does. Header only.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_AGENT_ALERTS_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_AGENT_ALERTS_H_

#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/shard/pipeline.h"
#include "services/rpc/identity.h"
#include "services/rpc/reading_pace.h"
#include "services/runtime/log.h"
#include "services/runtime/metrics.h"

namespace rips::pipeline {

// An alert of `robot`, whose agent (`sensor`, `actuator`) sent it. Any thread. `what`: field, size
// and limit. One kind of alert for the robot, whatever the field (kOwnAlertLimits).
inline void TellRefusedField(Pipeline& pipeline, absl::string_view agent, const std::string& robot,
                             absl::string_view host, absl::string_view address,
                             absl::string_view what) {
  pipeline
      .Post(robot, Lane::kControl,
            [text = absl::StrCat(agent, " ", robot, "/", host, " at ", address,
                                 " sent a message past a limit: ", what,
                                 "; its stream was closed. No agent of RIPS sends this: find out "
                                 "what uses its key")](Robot& each) {
              each.Report(engine::Severity::kHigh, text);
            })
      .IgnoreError();  // of a robot that is not served; it is logged and counted
}

// Tells a robot that the key of one of its agents was used for what none does (AttackAlerts): it
// doubts for a while what that agent says. Any thread.
inline void TellKeyMisused(Pipeline& pipeline, const rpc::PeerIdentity& agent,
                           const std::string& peer) {
  pipeline
      .Post(agent.robot, Lane::kControl,
            [misuse = input::KeyMisused{.sensor = agent.role == rpc::Role::kSensor,
                                        .host = agent.host,
                                        .peer = peer}](Robot& each) { each.OnKeyMisused(misuse); })
      .IgnoreError();  // of a robot that is not served
}

// Whether the stream of an agent's session reads on after a message. A pause is counted, and if it
// is news, logged and an alert as above: too much of that robot may wait for the alert to be
// raised.
inline bool ReadsOn(rpc::ReadingPace::Next next, rips::Counter& pauses, Pipeline& pipeline,
                    absl::string_view agent, const std::string& robot, absl::string_view host,
                    absl::string_view address) {
  if (next == rpc::ReadingPace::Next::kRead) return true;
  pauses.Increment();
  if (next != rpc::ReadingPace::Next::kPauseIsNews) return false;
  LogWarning("an agent is read slowly",
             {{"agent", agent}, {"robot", robot}, {"host", host}, {"peer", address}});
  pipeline
      .Post(robot, Lane::kControl,
            [text = absl::StrCat(agent, " ", robot, "/", host, " at ", address,
                                 " sends what takes more of the server's processor to read than "
                                 "one agent may use: it is read more slowly, so what it says "
                                 "comes late. Unless the robot has very much traffic, find out "
                                 "what uses its key")](Robot& each) {
              each.Report(engine::Severity::kMedium, text);
            })
      .IgnoreError();
  return false;
}

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_AGENT_ALERTS_H_
