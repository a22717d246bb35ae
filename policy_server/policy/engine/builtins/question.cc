#include "policy_server/policy/engine/builtins/question.h"

#include <array>
#include <cstddef>

namespace rips::engine {
namespace {

using lang::Builtin;

constexpr Question Of(Builtin builtin, Source source, Subject subject, Form form) {
  return {
      .builtin = builtin, .source = source, .subject = subject, .form = form, .prototype = form};
}
constexpr Question Topic(Builtin builtin, Subject subject, Form form) {
  return Of(builtin, Source::kTopic, subject, form);
}
constexpr Question Facts(Builtin builtin, Subject subject, Form form) {
  return Of(builtin, Source::kFacts, subject, form);
}
constexpr Question Graph(Builtin builtin, Subject subject, Form form) {
  return Of(builtin, Source::kGraph, subject, form);
}
// The prototype compares the other way round.
constexpr Question Turned(Question question) {
  question.prototype =
      question.form == Form::kGivenInCurrent ? Form::kCurrentInGiven : Form::kGivenInCurrent;
  return question;
}

constexpr auto kQuestions = std::to_array<Question>({
    Topic(Builtin::kTopicIn, Subject::kTopic, Form::kOneOf),
    Topic(Builtin::kTopicMatches, Subject::kTopic, Form::kMatches),
    Topic(Builtin::kMsgTypeIn, Subject::kTypes, Form::kOneOf),
    Topic(Builtin::kMsgSubtype, Subject::kTypes, Form::kIsType),
    Facts(Builtin::kPublisherCount, Subject::kPublishers, Form::kCount),
    Facts(Builtin::kSubscriberCount, Subject::kSubscribers, Form::kCount),
    Facts(Builtin::kPublishersInclude, Subject::kPublishers, Form::kGivenInCurrent),
    Turned(Facts(Builtin::kSubscribersInclude, Subject::kSubscribers, Form::kGivenInCurrent)),
    Facts(Builtin::kPublishers, Subject::kPublishers, Form::kExactly),
    Facts(Builtin::kSubscribers, Subject::kSubscribers, Form::kExactly),
    Graph(Builtin::kNodes, Subject::kNodes, Form::kExactly),
    Graph(Builtin::kTopics, Subject::kTopics, Form::kExactly),
    Graph(Builtin::kServices, Subject::kServicesOf, Form::kExactly),
    Graph(Builtin::kTopicPublishers, Subject::kPublishersOf, Form::kExactly),
    Graph(Builtin::kTopicSubscribers, Subject::kSubscribersOf, Form::kExactly),
    Graph(Builtin::kNodeCount, Subject::kNodes, Form::kCount),
    Graph(Builtin::kTopicCount, Subject::kTopics, Form::kCount),
    Graph(Builtin::kServiceCount, Subject::kServicesOf, Form::kCount),
    Graph(Builtin::kTopicPublisherCount, Subject::kPublishersOf, Form::kCount),
    Graph(Builtin::kTopicSubscriberCount, Subject::kSubscribersOf, Form::kCount),
    Graph(Builtin::kService, Subject::kServicesOf, Form::kHas),
    Turned(Graph(Builtin::kNodesInclude, Subject::kNodes, Form::kCurrentInGiven)),
    Turned(Graph(Builtin::kTopicsInclude, Subject::kTopics, Form::kCurrentInGiven)),
    Turned(Graph(Builtin::kServicesInclude, Subject::kServicesOf, Form::kCurrentInGiven)),
    Turned(Graph(Builtin::kTopicPublishersInclude, Subject::kPublishersOf, Form::kCurrentInGiven)),
    Turned(
        Graph(Builtin::kTopicSubscribersInclude, Subject::kSubscribersOf, Form::kCurrentInGiven)),
    Graph(Builtin::kNodesOnly, Subject::kNodes, Form::kCurrentInGiven),
    Graph(Builtin::kTopicsOnly, Subject::kTopics, Form::kCurrentInGiven),
    Graph(Builtin::kServicesOnly, Subject::kServicesOf, Form::kCurrentInGiven),
    Graph(Builtin::kTopicPublishersOnly, Subject::kPublishersOf, Form::kCurrentInGiven),
    Graph(Builtin::kTopicSubscribersOnly, Subject::kSubscribersOf, Form::kCurrentInGiven),
    Graph(Builtin::kHasNodes, Subject::kNodes, Form::kGivenInCurrent),
    Graph(Builtin::kHasTopics, Subject::kTopics, Form::kGivenInCurrent),
    Graph(Builtin::kHasServices, Subject::kServicesOf, Form::kGivenInCurrent),
    Graph(Builtin::kHasTopicPublishers, Subject::kPublishersOf, Form::kGivenInCurrent),
    Graph(Builtin::kHasTopicSubscribers, Subject::kSubscribersOf, Form::kGivenInCurrent),
});

// Where a builtin stands in the table; its end if it does not.
constexpr auto kRows = [] {
  std::array<size_t, lang::kBuiltinCount> rows{};
  rows.fill(kQuestions.size());
  for (size_t i = 0; i < kQuestions.size(); ++i) {
    rows[static_cast<size_t>(kQuestions[i].builtin)] = i;
  }
  return rows;
}();

}  // namespace

const Question* QuestionOf(Builtin builtin) {
  const size_t row = kRows[static_cast<size_t>(builtin)];
  return row == kQuestions.size() ? nullptr : &kQuestions[row];
}

}  // namespace rips::engine
