// What operators ask of a robot's level, and what they are told.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_LEVEL_ORDER_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_LEVEL_ORDER_H_

#include <cstddef>
#include <cstdint>
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
  // Who the operator is, whatever role the certificate has: `TRUST_DOMAIN/NAME`.
  std::string identity;
};

// A second operator's answer to a lowering that waits for one (Policy::two_person).
struct ApprovalOrder {
  std::string operator_name;
  std::string identity;
  // Of the lowering.
  std::string id;
  std::string reason;
  bool reject = false;
  bool accept_blind = false;
  // PendingApproval::changes may be there.
  bool accept_changes = false;
  std::string request_id;
};

// That the robot's agents may be away. Identity and role were checked by the caller.
struct MaintenanceOrder {
  std::string operator_name;
  std::string reason;
  // From now on; 0 = it ends now.
  int64_t for_ns = 0;
};

// A lowering that waits for a second operator.
struct PendingApproval {
  std::string id;
  std::string from;
  std::string to;
  DecisionId decision_id;
  std::string operator_name;
  std::string reason;
  bool accept_blind = false;
  // By the clock of the server's host.
  int64_t asked_unix_ns = 0;
  int64_t expires_unix_ns = 0;
  // How the graph differs from the one when it was asked, in what the lowering is not judged by.
  std::vector<std::string> changes;

  friend bool operator==(const PendingApproval&, const PendingApproval&) = default;
};

// An administrator's: the server is to go above the term for which an actuator was refused.
struct TermResetOrder {
  std::string operator_name;
  std::string host;
  std::string reason;
};

// A signal that the rules are to judge.
struct SignalOrder {
  std::string operator_name;
  // SIGUSR1 | SIGUSR2
  std::string signal;
  std::string reason;
};

inline constexpr size_t kReasonBytesMax = 1'000;

struct LevelAnswer {
  absl::Status status;
  DecisionId decision_id;
  std::string decided_level;
  // Of a signal only: the level that was decided before it.
  std::string level_before;
  std::vector<std::string> would_raise_again;
  std::vector<std::string> blind_because;
  // The level decided is soft: rules may lower it again.
  bool soft = false;
  // Nothing is decided: a second operator must approve it.
  bool needs_approval = false;
  // What waits now, if it was not a dry run.
  std::string pending_approval_id;
  int64_t approval_expires_unix_ns = 0;
};
using LevelReply = std::function<void(const LevelAnswer&)>;

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_LEVEL_ORDER_H_
