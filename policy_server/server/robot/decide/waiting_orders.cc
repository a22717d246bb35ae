#include "policy_server/server/robot/decide/waiting_orders.h"

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

void WaitingOrders::Wait(const DecisionId& decision_id, std::string request_id,
                         action::AnswerOrder answer) {
  waiting_[decision_id] = {std::move(request_id), std::move(answer)};
}

std::optional<action::AnswerOrder> WaitingOrders::OnDurable(const DecisionId& decision_id) {
  auto order = waiting_.extract(decision_id);
  if (order.empty()) return std::nullopt;
  answered_.emplace_back(std::move(order.mapped().request_id), order.mapped().answer.answer);
  if (answered_.size() > kAnswersKept) answered_.pop_front();
  return std::move(order.mapped().answer);
}

std::optional<action::AnswerOrder> WaitingOrders::Refuse(const DecisionId& decision_id,
                                                         const absl::Status& why) {
  auto order = waiting_.extract(decision_id);
  if (order.empty()) return std::nullopt;
  order.mapped().answer.answer.status = why;
  return std::move(order.mapped().answer);
}

std::vector<action::AnswerOrder> WaitingOrders::RefuseAll(const absl::Status& why) {
  std::vector<action::AnswerOrder> answers;
  for (auto& [decision_id, order] : std::exchange(waiting_, {})) {
    order.answer.answer.status = why;
    answers.push_back(std::move(order.answer));
  }
  return answers;
}

}  // namespace rips::pipeline
