#include "policy_server/policy/engine/interest/kept_topics.h"

#include <algorithm>
#include <string>
#include <variant>
#include <vector>

#include "services/ros2/ros_name.h"

namespace rips::engine {
namespace {

using lang::Builtin;
using lang::TypedExpr;

// Of the arguments of a call, how many name topics, from the first on.
size_t TopicArgs(const TypedExpr& call) {
  switch (call.builtin) {
    case Builtin::kTopicIn:
    case Builtin::kTopics:
    case Builtin::kTopicsInclude:
    case Builtin::kTopicsOnly:
    case Builtin::kHasTopics:
      return call.args.size();
    case Builtin::kTopicPublishers:
    case Builtin::kTopicSubscribers:
    case Builtin::kTopicPublishersInclude:
    case Builtin::kTopicSubscribersInclude:
    case Builtin::kTopicPublishersOnly:
    case Builtin::kTopicSubscribersOnly:
    case Builtin::kHasTopicPublishers:
    case Builtin::kHasTopicSubscribers:
    case Builtin::kTopicPublisherCount:
    case Builtin::kTopicSubscriberCount:
      return std::min<size_t>(call.args.size(), 1);
    default:
      return 0;
  }
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
