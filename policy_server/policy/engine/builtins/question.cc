#include "policy_server/policy/engine/builtins/question.h"

#include <cstddef>
#include <optional>

namespace rips::engine {
namespace {

using lang::Builtin;

// By builtin; none for those that ask neither the topic nor the graph.
constexpr std::optional<Question> kQuestions[] = {
#define RIPS_BUILTIN(...) std::nullopt,
#define RIPS_QUESTION(name, spelling, event_class, parameters, list, origin, help, source, \
                      subject, form, prototype)                                            \
  Question{Builtin::k##name, Source::source, Subject::subject, Form::form, Form::prototype},
#include "policy_server/policy/lang/builtin.def"
};

}  // namespace

const Question* QuestionOf(Builtin builtin) {
  const std::optional<Question>& question = kQuestions[static_cast<size_t>(builtin)];
  return question.has_value() ? &*question : nullptr;
}

}  // namespace rips::engine
