#include "policy_server/server/robot/parts/waiting_orders.h"

#include <utility>

namespace rips::pipeline {

std::optional<LevelAnswer> WaitingOrders::Repeated(absl::string_view request_id) const {
  if (request_id.empty()) return std::nullopt;
  for (const auto& [id, answer] : answered_) {
    if (id == request_id) return answer;
  }
  for (const auto& [decision_id, order] : waiting_) {
    if (order.request_id != request_id) continue;
    return LevelAnswer{.status =
                           absl::UnavailableError("this request is being recorded; repeat it")};
  }
  return std::nullopt;
}

void WaitingOrders::Wait(const DecisionId& decision_id, std::string request_id, LevelAnswer answer,
                         LevelReply reply) {
  waiting_[decision_id] = {std::move(request_id), std::move(answer), std::move(reply)};
}

void WaitingOrders::OnDurable(const DecisionId& decision_id) {
  auto order = waiting_.extract(decision_id);
  if (order.empty()) return;
  answered_.emplace_back(std::move(order.mapped().request_id), order.mapped().answer);
  if (answered_.size() > kAnswersKept) answered_.pop_front();
  order.mapped().reply(order.mapped().answer);
}

void WaitingOrders::Refuse(const DecisionId& decision_id, const absl::Status& why) {
  auto order = waiting_.extract(decision_id);
  if (order.empty()) return;
  order.mapped().answer.status = why;
  order.mapped().reply(order.mapped().answer);
}

void WaitingOrders::RefuseAll(const absl::Status& why) {
  for (auto& [decision_id, order] : std::exchange(waiting_, {})) {
    order.answer.status = why;
    order.reply(order.answer);
  }
}

}  // namespace rips::pipeline
