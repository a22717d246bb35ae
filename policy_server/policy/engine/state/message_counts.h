// What counts in the windows of `msgcount` and `sendercount`: messages that came, and messages that
// were lost.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_MESSAGE_COUNTS_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_MESSAGE_COUNTS_H_

#include <cstdint>

#include "policy_server/policy/engine/state/event.h"
#include "policy_server/policy/engine/state/internal.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/policy/engine/state/topic_verdicts.h"

namespace rips::engine {

// Counts the message, where a rule that applies to its topic counts. Times never go back.
void CountMessage(const MessageEvent& message, const TopicVerdict& verdict, int64_t time_ns,
                  RobotState::Internal& in);

// Counts what was lost, not after `time_ns`, so that no window holds less than if it had come:
//   - of a topic in the windows of the topic;
//   - of one writer in those of the writer, else in those of every writer on the topic, known or
//     not;
//   - without a topic in every window.
// Without a type it counts as if every rule applied.
void CountLoss(const model::Loss& loss, int64_t time_ns, RobotState& state);

// Those of the message's topic, or of its writer on it, later than `now_ns - window_ns`.
uint64_t CountOfTopic(const MessageEvent& message, int64_t now_ns, int64_t window_ns,
                      const RobotState::Internal& in);
uint64_t CountOfSender(const MessageEvent& message, int64_t now_ns, int64_t window_ns,
                       const RobotState::Internal& in);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_MESSAGE_COUNTS_H_
