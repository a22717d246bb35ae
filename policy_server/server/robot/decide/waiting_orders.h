// Operators' orders whose decision is not durable yet, and the newest answers: an order that is
// sent again, as after a connection was lost, is answered and not made twice.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_WAITING_ORDERS_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_WAITING_ORDERS_H_

#include <cstddef>
#include <deque>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/robot/context/action.h"
#include "policy_server/server/robot/model/level_order.h"
#include "services/base/decision_id.h"

namespace rips::pipeline {

// Not thread-safe. Each order is answered once.
class WaitingOrders {
 public:
  static constexpr size_t kAnswersKept = 64;

  // The answer for an order that repeats an earlier one; Unavailable while that one waits.
  // `request_id` empty: it repeats none.
  std::optional<LevelAnswer> Repeated(absl::string_view request_id) const;
  // `answer` is what the order gets when the decision `decision_id` is durable.
  void Wait(const DecisionId& decision_id, std::string request_id, action::AnswerOrder answer);
  // Both: the answer of the order that waited for this decision, if one did. Refused: the decision
  // is not in force.
  std::optional<action::AnswerOrder> OnDurable(const DecisionId& decision_id);
  std::optional<action::AnswerOrder> Refuse(const DecisionId& decision_id, const absl::Status& why);
  std::vector<action::AnswerOrder> RefuseAll(const absl::Status& why);

 private:
  struct Order {
    std::string request_id;
    action::AnswerOrder answer;
  };

  absl::btree_map<DecisionId, Order> waiting_;
  // By request id, oldest first.
  std::deque<std::pair<std::string, LevelAnswer>> answered_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_DECIDE_WAITING_ORDERS_H_
