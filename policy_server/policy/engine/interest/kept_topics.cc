#include "policy_server/policy/engine/interest/kept_topics.h"

#include <algorithm>
#include <string>
#include <variant>
#include <vector>

#include "policy_server/policy/engine/builtins/question.h"
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
  std::vector<const TypedExpr*> left = {&expr};
  while (!left.empty()) {
    const TypedExpr& at = *left.back();
    left.pop_back();
    const size_t topics = at.kind == TypedExpr::Kind::kCall ? TopicArgs(at) : 0;
    for (size_t i = 0; i < at.args.size(); ++i) {
      const TypedExpr& arg = at.args[i];
      left.push_back(&arg);
      if (i >= topics || arg.kind != TypedExpr::Kind::kConstant) continue;
      const auto* name = std::get_if<std::string>(&arg.constant);
      if (name == nullptr || names.size() >= ros2::kKeptTopicsMax) continue;
      if (ros2::ValidateTopicName(*name).ok()) names.insert(*name);
    }
  }
}

}  // namespace

ros2::TopicNames KeptTopics(const lang::CheckedRules& rules) {
  ros2::TopicNames names;
  for (const lang::TypedRule& rule : rules.rules) {
    AddTopics(rule.condition, names);
    for (const lang::TypedChain& chain : rule.chains) {
      for (const lang::TypedAction& action : chain) {
        for (const TypedExpr& arg : action.args) AddTopics(arg, names);
      }
    }
  }
  return names;
}

}  // namespace rips::engine
