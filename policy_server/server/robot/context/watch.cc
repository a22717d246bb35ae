#include "policy_server/server/robot/context/watch.h"

#include <cstdint>
#include <utility>

#include "policy_server/policy/engine/interest/merge_interest.h"

namespace rips::pipeline {

void Watch::SetAlso(std::shared_ptr<const AlsoWatched> also, const Policy& policy) {
  also_ = std::move(also);
  if (also_ == nullptr) {
    plan_.reset();
    limits_.clear();
    kept_topics_.reset();
    return;
  }
  const engine::Interest in_force{.plan = *policy.interest, .limits = policy.payload_limits};
  in_force_ = std::make_unique<engine::InterestReader>(in_force);
  engine::Interest merged = engine::MergeInterest(in_force, also_->interest);
  plan_ = std::make_shared<const engine::InterestPlan>(std::move(merged.plan));
  limits_ = std::move(merged.limits);
  kept_topics_ = std::make_shared<const ros2::TopicNames>(
      engine::MergeKeptTopics(*policy.kept_topics, also_->kept_topics));
}

void Watch::OnPolicy(const Policy& policy) {
  if (also_ != nullptr) return SetAlso(also_, policy);
  // Messages that the policy before asked for are judged, as ever.
  in_force_.reset();
}

std::shared_ptr<const engine::InterestPlan> Watch::plan(const Policy& policy) const {
  return plan_ != nullptr ? plan_ : policy.interest;
}

const engine::PayloadLimits& Watch::limits(const Policy& policy) const {
  return plan_ != nullptr ? limits_ : policy.payload_limits;
}

std::shared_ptr<const ros2::TopicNames> Watch::kept_topics(const Policy& policy) const {
  return kept_topics_ != nullptr ? kept_topics_ : policy.kept_topics;
}

bool Watch::Concerns(absl::string_view topic) const {
  return in_force_ == nullptr || in_force_->Of(topic).depth != engine::Depth::kNothing;
}

size_t Watch::PayloadBytes(absl::string_view topic) const {
  return in_force_ == nullptr ? SIZE_MAX : in_force_->Of(topic).payload_bytes;
}

}  // namespace rips::pipeline
