// What each builtin asks of the message's topic or of the graph, as one table.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_QUESTION_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_QUESTION_H_

#include <cstdint>

#include "policy_server/policy/lang/checked_rules.h"

namespace rips::engine {

// What an answer stays the same with, the arguments being constant.
enum class Source : uint8_t {
  kTopic,  // the topic and its types
  kFacts,  // who publishes and subscribes to it
  kGraph,
};

// What is looked at. Of those in the last line, the first argument is the node or topic.
enum class Subject : uint8_t {
  // clang-format off
  kTopic, kTypes, kPublishers, kSubscribers,  // of the message
  kNodes, kTopics,
  kServicesOf, kPublishersOf, kSubscribersOf,
  // clang-format on
};

// How it is compared with the arguments.
enum class Form : uint8_t {
  kOneOf,    // it is one of them
  kMatches,  // the topic matches a pattern; answered by TopicVerdicts
  kIsType,   // one of the types is of this package and name
  // Sets of names.
  kExactly,
  kCurrentInGiven,
  kGivenInCurrent,
  kHas,    // this one name is there
  kCount,  // as many are there as the range says
};

struct Question {
  lang::Builtin builtin = lang::Builtin::kEval;
  Source source = Source::kGraph;
  Subject subject = Subject::kNodes;
  Form form = Form::kExactly;
  Form prototype = Form::kExactly;  // the form in the prototype's dialect

  // The first argument is the node or topic that is asked about.
  bool names_subject() const { return subject >= Subject::kServicesOf; }
};

// Null for builtins that ask neither of them.
const Question* QuestionOf(lang::Builtin builtin);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_BUILTINS_QUESTION_H_
