#include "policy_server/policy/engine/interest/kept_topics.h"

#include <algorithm>
#include <string>

#include "policy_server/policy/engine/builtins/question.h"
#include "policy_server/policy/lang/walk.h"
#include "services/ros2/ros_name.h"

namespace rips::engine {
namespace {

using lang::TypedExpr;

// Of the arguments of a call, how many name topics, from the first on.
size_t TopicArgs(const TypedExpr& call) {
  const Question* question = QuestionOf(call.builtin);
  if (question == nullptr) return 0;
  switch (question->subject) {
    case Subject::kTopic:
      return question->form == Form::kMatches ? 0 : call.args.size();
    case Subject::kTopics:
      return call.args.size();
    case Subject::kPublishersOf:
    case Subject::kSubscribersOf:
      return std::min<size_t>(call.args.size(), 1);
    case Subject::kTypes:
    case Subject::kPublishers:
    case Subject::kSubscribers:
    case Subject::kNodes:
    case Subject::kServicesOf:
      break;
  }
  return 0;
}

void AddTopics(const TypedExpr& expr, ros2::TopicNames& names) {
  const size_t topics = expr.kind == TypedExpr::Kind::kCall ? TopicArgs(expr) : 0;
  for (size_t i = 0; i < topics && names.size() < ros2::kKeptTopicsMax; ++i) {
    const std::string* name = expr.args[i].constant_text();
    if (name != nullptr && ros2::ValidateTopicName(*name).ok()) names.insert(*name);
  }
}

}  // namespace

ros2::TopicNames KeptTopics(const lang::CheckedRules& rules) {
  ros2::TopicNames names;
  for (const lang::TypedRule& rule : rules.rules) {
    lang::ForEachExpr(rule, [&](const TypedExpr& expr) { AddTopics(expr, names); });
  }
  return names;
}

}  // namespace rips::engine
