// What operators ask of a robot's level, and what they are told.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_LEVEL_ORDER_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_LEVEL_ORDER_H_

#include <cstddef>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "services/base/decision_id.h"

namespace rips::pipeline {

// What an operator asks of the level. Identity and role were checked by the caller.
struct LevelOrder {
  std::string operator_name;
  std::string to;
  std::string reason;
  std::string expected_level;
  DecisionId expected_decision_id;
  bool dry_run = false;
  bool accept_blind = false;
  std::string request_id;
};

// An administrator's: the server is to go above the term for which an actuator was refused.
struct TermResetOrder {
  std::string operator_name;
  std::string host;
  std::string reason;
};

inline constexpr size_t kReasonBytesMax = 1'000;

struct LevelAnswer {
  absl::Status status;
  DecisionId decision_id;
  std::string decided_level;
  std::vector<std::string> would_raise_again;
  std::vector<std::string> blind_because;
  // The level decided is soft: rules may lower it again.
  bool soft = false;
};
using LevelReply = std::function<void(const LevelAnswer&)>;

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_LEVEL_ORDER_H_
