#include "policy_server/server/robot/context/policy.h"

#include "policy_server/policy/engine/interest/kept_topics.h"
#include "services/base/payload_limits.h"

namespace rips::pipeline {

std::shared_ptr<const engine::InterestPlan> MakeInterest(const engine::CompiledPolicy& program) {
  return std::make_shared<const engine::InterestPlan>(
      engine::PlanInterest(program.rules(), kPayloadBytesDefault));
}

std::shared_ptr<const ros2::TopicNames> MakeKeptTopics(const engine::CompiledPolicy& program) {
  return std::make_shared<const ros2::TopicNames>(engine::KeptTopics(program.rules()));
}

void CompletePolicy(Policy& policy) {
  if (policy.interest == nullptr) policy.interest = MakeInterest(*policy.program);
  if (policy.kept_topics == nullptr) policy.kept_topics = MakeKeptTopics(*policy.program);
}

}  // namespace rips::pipeline
