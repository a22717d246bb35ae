// Policy: what a robot is judged by.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_POLICY_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_POLICY_H_

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "policy_server/policy/engine/interest/interest.h"
#include "policy_server/policy/engine/state/compiled_policy.h"
#include "policy_server/policy/levels/level_table.h"
#include "services/base/clock.h"
#include "services/ros2/graph_limits.h"

namespace rips::pipeline {

class Inspector;  // ports.h

// A bundle that is in force.
struct Policy {
  std::shared_ptr<const engine::CompiledPolicy> program;
  // "sha256:" + 64 hex.
  std::string bundle_id;
  levels::LevelIndex start_level = 0;
  int64_t soft_hold_ns = 5 * kNanosPerSecond;
  // Names of the levels that an operator lowers only if a second one approves. None is soft.
  std::vector<std::string> two_person;
  // Opaque here. Null: no message is inspected, and rules that want it get no verdict.
  std::shared_ptr<Inspector> inspector;
  // What the program needs (MakeInterest), so that robots share it; null: each finds out itself.
  std::shared_ptr<const engine::InterestPlan> interest;
  // What a truncated graph keeps first (engine::KeptTopics), likewise.
  std::shared_ptr<const ros2::TopicNames> kept_topics;
  // Of payloads that inspections look at; kPayloadBytesDefault where none matches.
  engine::PayloadLimits payload_limits;
};

// Takes as long as compiling the rules.
std::shared_ptr<const engine::InterestPlan> MakeInterest(const engine::CompiledPolicy& program);

std::shared_ptr<const ros2::TopicNames> MakeKeptTopics(const engine::CompiledPolicy& program);

// Makes what is null of both.
void CompletePolicy(Policy& policy);

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_POLICY_H_
