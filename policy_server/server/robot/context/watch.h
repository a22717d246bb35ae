// What a robot's sensors are asked to watch: what the policy in force needs and, while another one
// runs muted beside it (server/shadow), what that one needs too. Pure.
//
// What comes of it                          the policy in force is given
//   a message or loss of a topic of which   nothing: neither its rules nor the evidence, the
//   only the other asked for messages       losses or the coverage know of it
//   a payload of which the other asked      as many bytes as without the other
//   for more bytes
//   all else                                all of it
//
// This stays so after the other has ended: messages may still be on their way.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_WATCH_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_WATCH_H_

#include <cstddef>
#include <memory>

#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/interest/interest_need.h"
#include "policy_server/server/robot/context/policy.h"
#include "services/ros2/graph_limits.h"

namespace rips::pipeline {

// Of a policy that runs muted.
struct AlsoWatched {
  engine::Interest interest;
  ros2::TopicNames kept_topics;
};

// Not thread-safe. `policy` is always the one in force, complete (CompletePolicy).
class Watch {
 public:
  // Null: no other policy runs from now on. Takes as long as compiling the patterns of both.
  void SetAlso(std::shared_ptr<const AlsoWatched> also, const Policy& policy);
  // Another policy is in force.
  void OnPolicy(const Policy& policy);

  // Another policy runs muted.
  bool also() const { return also_ != nullptr; }
  // What to ask for.
  std::shared_ptr<const engine::InterestPlan> plan(const Policy& policy) const;
  const engine::PayloadLimits& limits(const Policy& policy) const;
  std::shared_ptr<const ros2::TopicNames> kept_topics(const Policy& policy) const;

  // The policy in force asks for messages of this topic.
  bool Concerns(absl::string_view topic) const;
  // At most so many bytes of a payload are for the policy in force.
  size_t PayloadBytes(absl::string_view topic) const;

 private:
  std::shared_ptr<const AlsoWatched> also_;
  // What is asked for together; null while no other policy runs.
  std::shared_ptr<const engine::InterestPlan> plan_;
  engine::PayloadLimits limits_;
  std::shared_ptr<const ros2::TopicNames> kept_topics_;
  // Of the policy in force; null until another one runs for the first time.
  std::unique_ptr<engine::InterestReader> in_force_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_WATCH_H_
