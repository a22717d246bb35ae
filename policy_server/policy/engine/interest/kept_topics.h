// Topics that rules name, of which a graph at its limits keeps the endpoints first
// (services/ros2/graph_limits.h): a second driver must not hide behind a thousand made-up topics.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_KEPT_TOPICS_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_KEPT_TOPICS_H_

#include "policy_server/policy/lang/checked_rules.h"
#include "services/ros2/graph_limits.h"

namespace rips::engine {

// Names that stand as constants in conditions and arguments of all rules, where a builtin takes a
// topic: `topicin`, the forms about topics, and the first argument of those about one topic. Not
// patterns, and not what is put together. The first kKeptTopicsMax in the order of the rules; what
// rules ask about others is unscanned while the graph is truncated.
ros2::TopicNames KeptTopics(const lang::CheckedRules& rules);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_INTEREST_KEPT_TOPICS_H_
