// Calls: predicates that are remembered, and what is asked of the event itself.
#include <algorithm>
#include <utility>

#include "absl/container/inlined_vector.h"
#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/builtins/builtins.h"
#include "policy_server/policy/engine/builtins/question.h"
#include "policy_server/policy/engine/eval/evaluation.h"
#include "policy_server/policy/engine/state/internal.h"
#include "policy_server/policy/engine/state/message_counts.h"
#include "policy_server/policy/engine/state/topic_verdicts.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/value_text.h"

namespace rips::engine {
namespace {

using lang::Builtin;
using lang::ValueType;

EvalStatus TopicPredicate(const EvalNode& node, Evaluation& run, Slot& out) {
  const auto index = static_cast<size_t>(node.index);
  out.truth = run.topic != nullptr ? run.topic->verdict->holds[index]
                                   : Holds(run.compiled->predicates[index], run.scene);
  return EvalStatus::kValue;
}

// The graph may change before the message is judged, and some recordings hold none.
bool GraphOpen(const Evaluation& run) { return !run.foreseeing && run.state->graph_known; }

// What the graph tells of predicates[index], remembered in `answers` unless that is null. Of a
// truncated graph two answers are remembered, the second behind all the first ones: whether what
// was left out may turn it.
EvalStatus EvaluateGraph(const std::vector<Predicate>& predicates, size_t index, Answers* answers,
                         Evaluation& run, Slot& out) {
  const Predicate& predicate = predicates[index];
  const EvalContext& scene = run.scene;
  const bool truncated = scene.graph.truncated();
  const size_t count = truncated ? 2 * predicates.size() : predicates.size();
  const auto decide = [&] { return Holds(predicate, scene); };
  out.truth = answers != nullptr ? answers->Get(index, count, decide) : decide();
  if (!truncated) return EvalStatus::kValue;
  const auto left_open = [&] { return LeftOpen(predicate.builtin, predicate.args, scene); };
  const bool open =
      answers != nullptr ? answers->Get(predicates.size() + index, count, left_open) : left_open();
  return open ? run.LeftOpen() : EvalStatus::kValue;
}

EvalStatus FactsPredicate(const EvalNode& node, Evaluation& run, Slot& out) {
  if (!GraphOpen(run)) return EvalStatus::kUndecidable;
  return EvaluateGraph(run.compiled->facts, static_cast<size_t>(node.index),
                       run.topic != nullptr ? &run.topic->answers : nullptr, run, out);
}

EvalStatus GraphPredicate(const EvalNode& node, Evaluation& run, Slot& out) {
  if (!GraphOpen(run)) return EvalStatus::kUndecidable;
  return EvaluateGraph(run.compiled->graph, static_cast<size_t>(node.index), run.graph_answers, run,
                       out);
}

// Evaluates all arguments. kValue, or why not.
EvalStatus EvalArgs(const EvalNode& node, Evaluation& run, absl::InlinedVector<Scalar, 8>& args) {
  EvalStatus all = EvalStatus::kValue;
  args.reserve(node.args.size());
  for (const EvalNode* arg : node.args) {
    Slot cell;
    const EvalStatus answer = Eval(*arg, run, cell);
    if (answer == EvalStatus::kFault) return answer;
    all = std::max(all, answer);
    if (answer == EvalStatus::kValue) args.push_back(ToScalar(cell, arg->type));
  }
  return all;
}

// A question to the graph or the topic whose arguments are not constant.
EvalStatus EvaluateNow(const EvalNode& node, Evaluation& run, Slot& out) {
  absl::InlinedVector<Scalar, 8> args;
  const EvalStatus answer = EvalArgs(node, run, args);
  if (answer != EvalStatus::kValue) return answer;
  if (!GraphOpen(run)) return EvalStatus::kUndecidable;
  const std::optional<bool> told = Ask(node.builtin, args, run.scene);
  if (!told.has_value()) return run.Fault("internal: arguments that do not fit");
  out.truth = *told;
  return LeftOpen(node.builtin, args, run.scene) ? run.LeftOpen() : EvalStatus::kValue;
}

// topicin and its like need no graph.
EvalStatus EvaluateTopicNow(const EvalNode& node, Evaluation& run, Slot& out) {
  absl::InlinedVector<Scalar, 8> args;
  const EvalStatus answer = EvalArgs(node, run, args);
  if (answer != EvalStatus::kValue) return answer;
  const std::optional<bool> told = Ask(node.builtin, args, run.scene);
  if (!told.has_value()) return run.Fault("internal: arguments that do not fit");
  out.truth = *told;
  return EvalStatus::kValue;
}

// True if `holds` is of one of the arguments, which are strings.
template <typename Predicate>
EvalStatus AnyArg(const EvalNode& node, Evaluation& run, Slot& out, const Predicate& holds) {
  EvalStatus all = EvalStatus::kValue;
  bool found = false;
  for (const EvalNode* arg : node.args) {
    Slot cell;
    const EvalStatus answer = Eval(*arg, run, cell);
    if (answer == EvalStatus::kFault) return answer;
    all = std::max(all, answer);
    found = found || (answer == EvalStatus::kValue && holds(cell.text));
  }
  out.truth = found;
  return found ? EvalStatus::kValue : all;
}

EvalStatus SenderIn(const EvalNode& node, Evaluation& run, Slot& out) {
  const absl::string_view sender = run.message == nullptr ? "" : run.message->sender;
  const EvalStatus answer = AnyArg(node, run, out, [&](absl::string_view name) {
    return !sender.empty() && ros2::NodeNameMatches(name, sender);
  });
  // The node of a writer that was left out is unknown.
  const bool open = answer == EvalStatus::kValue && sender.empty() && run.message != nullptr &&
                    !run.message->writer.none() && run.scene.truncated() &&
                    run.scene.graph.FindEndpoint(run.message->writer) == nullptr;
  return open ? run.LeftOpen() : answer;
}

EvalStatus SenderEnclave(const EvalNode& node, Evaluation& run, Slot& out) {
  const ros2::Participant* participant = nullptr;
  if (run.message != nullptr && !run.message->writer.none()) {
    if (!GraphOpen(run)) return EvalStatus::kUndecidable;
    const auto& participants = run.scene.graph.participants();
    const auto found = participants.find(run.message->writer.Participant());
    if (found != participants.end()) participant = &found->second;
  }
  if (participant == nullptr && run.message != nullptr && !run.message->writer.none() &&
      run.scene.truncated()) {
    return run.LeftOpen();
  }
  return AnyArg(node, run, out, [&](absl::string_view enclave) {
    return participant != nullptr && participant->authenticated && participant->enclave == enclave;
  });
}

// Two integers, inclusive.
EvalStatus InRange(const EvalNode& node, Evaluation& run, Slot& out, uint64_t count) {
  Slot min;
  Slot max;
  EvalStatus answer = Eval(*node.args[node.args.size() - 2], run, min);
  if (answer == EvalStatus::kFault) return answer;
  answer = std::max(answer, Eval(*node.args.back(), run, max));
  if (answer != EvalStatus::kValue) return answer;
  const auto n = static_cast<int64_t>(std::min<uint64_t>(count, INT64_MAX));
  out.truth = min.integer <= n && n <= max.integer;
  return EvalStatus::kValue;
}

EvalStatus PayloadSize(const EvalNode& node, Evaluation& run, Slot& out) {
  return InRange(node, run, out, run.message == nullptr ? 0 : run.message->size_bytes);
}

// EvalNode::index is the window. The window itself, args[0], is constant.
EvalStatus MsgCount(const EvalNode& node, Evaluation& run, Slot& out) {
  if (run.foreseeing) return EvalStatus::kUndecidable;
  uint64_t count = 0;
  if (run.message != nullptr) {
    count = CountOfTopic(*run.message, run.time_ns, node.index, run.state->internal());
  }
  return InRange(node, run, out, count);
}

EvalStatus SenderCount(const EvalNode& node, Evaluation& run, Slot& out) {
  if (run.foreseeing) return EvalStatus::kUndecidable;
  if (run.message == nullptr || run.message->writer.none()) {
    out.truth = false;
    return EvalStatus::kValue;
  }
  return InRange(node, run, out,
                 CountOfSender(*run.message, run.time_ns, node.index, run.state->internal()));
}

// EvalNode::index is that of the inspection.
EvalStatus Payload(const EvalNode& node, Evaluation& run, Slot& out) {
  const auto index = static_cast<size_t>(node.index);
  if (run.asked != nullptr) run.asked->push_back(static_cast<uint32_t>(index));
  if (run.message == nullptr || index >= run.message->inspections.size()) {
    return EvalStatus::kUnscanned;
  }
  const Verdict verdict = run.message->inspections[index];
  out.truth = verdict == Verdict::kYes;
  return verdict == Verdict::kUnscanned ? EvalStatus::kUnscanned : EvalStatus::kValue;
}

EvalStatus Plugin(const EvalNode& node, Evaluation& run, Slot& out) {
  return Payload(node, run, out);
}

template <typename What>
const What* ExternalOf(const Evaluation& run) {
  return run.external == nullptr ? nullptr : std::get_if<What>(run.external);
}

// `N` or `G:N`.
bool IsSignature(absl::string_view text, const model::IdsAlert& ids) {
  const size_t colon = text.find(':');
  uint32_t gid = ids.gid;
  uint32_t sid = 0;
  const auto number = [](absl::string_view digits, uint32_t& out) {
    return !digits.empty() && std::all_of(digits.begin(), digits.end(), absl::ascii_isdigit) &&
           absl::SimpleAtoi(digits, &out);
  };
  if (colon != absl::string_view::npos && !number(text.substr(0, colon), gid)) return false;
  if (!number(text.substr(colon == absl::string_view::npos ? 0 : colon + 1), sid)) return false;
  return gid == ids.gid && sid == ids.sid;
}

// Only digits, and a colon between them: a signature, and never part of a message.
bool LooksLikeSignature(absl::string_view text) {
  const size_t colon = text.find(':');
  const auto digits = [](absl::string_view part) {
    return !part.empty() && std::all_of(part.begin(), part.end(), absl::ascii_isdigit);
  };
  if (colon == absl::string_view::npos) return digits(text);
  return digits(text.substr(0, colon)) && digits(text.substr(colon + 1));
}

EvalStatus IdsAlert(const EvalNode& node, Evaluation& run, Slot& out) {
  const model::IdsAlert* ids = ExternalOf<model::IdsAlert>(run);
  return AnyArg(node, run, out, [&](absl::string_view text) {
    if (ids == nullptr) return false;
    if (LooksLikeSignature(text)) return IsSignature(text, *ids);
    return absl::StrContains(ids->line.empty() ? ids->message : ids->line, text);
  });
}

EvalStatus Signal(const EvalNode& node, Evaluation& run, Slot& out) {
  const model::SignalSeen* signal = ExternalOf<model::SignalSeen>(run);
  return AnyArg(node, run, out, [&](absl::string_view name) {
    return signal != nullptr && (name == signal->name || absl::StrCat("SIG", name) == signal->name);
  });
}

EvalStatus Agent(const EvalNode& node, Evaluation& run, Slot& out) {
  const AgentEvent* agent = ExternalOf<AgentEvent>(run);
  Slot kind;
  Slot state;
  EvalStatus answer = Eval(*node.args[0], run, kind);
  if (answer == EvalStatus::kFault) return answer;
  answer = std::max(answer, Eval(*node.args[1], run, state));
  if (answer != EvalStatus::kValue) return answer;
  out.truth = agent != nullptr && agent->agent == kind.text && agent->state == state.text;
  return EvalStatus::kValue;
}

EvalStatus Finding(const EvalNode& node, Evaluation& run, Slot& out) {
  const model::Finding* finding = ExternalOf<model::Finding>(run);
  return AnyArg(node, run, out, [&](absl::string_view kind) {
    return finding != nullptr && finding->kind == kind;
  });
}

// What is known to stand is enough, whatever else is not known.
EvalStatus FindingStands(const EvalNode& node, Evaluation& run, Slot& out) {
  if (run.foreseeing) return EvalStatus::kUndecidable;
  bool known = true;
  const EvalStatus answer = AnyArg(node, run, out, [&](absl::string_view kind) {
    const std::optional<bool> stands = run.state->findings.Stands(kind);
    known = known && stands.has_value();
    return stands.value_or(false);
  });
  if (answer != EvalStatus::kValue || out.truth) return answer;
  return known ? EvalStatus::kValue : EvalStatus::kUndecidable;
}

EvalStatus LostEvents(const EvalNode& node, Evaluation& run, Slot& out) {
  const model::Loss* loss = ExternalOf<model::Loss>(run);
  Slot min;
  const EvalStatus answer = Eval(*node.args[0], run, min);
  if (answer != EvalStatus::kValue) return answer;
  out.truth =
      loss != nullptr && (min.integer <= 0 || static_cast<uint64_t>(min.integer) <= loss->count);
  return EvalStatus::kValue;
}

EvalStatus LevelName(const EvalNode& node, Evaluation& run, Slot& out) {
  Slot index;
  const EvalStatus answer = Eval(*node.args[0], run, index);
  if (answer != EvalStatus::kValue) return answer;
  const levels::LevelTable& table = run.program->rules().levels;
  const bool known = index.integer >= 0 && index.integer < table.size();
  out.text = known
                 ? absl::string_view(table.at(static_cast<levels::LevelIndex>(index.integer)).name)
                 : absl::string_view();
  return EvalStatus::kValue;
}

EvalStatus String(const EvalNode& node, Evaluation& run, Slot& out) {
  Slot value;
  const EvalStatus answer = Eval(*node.args[0], run, value);
  if (answer != EvalStatus::kValue) return answer;
  switch (node.args[0]->type) {
    case ValueType::kString:
      out.text = value.text;
      break;
    case ValueType::kBool:
      out.text = value.truth ? "true" : "false";
      break;
    case ValueType::kFloat:
      out.text = run.Keep(lang::FormatFloat(value.real));
      break;
    case ValueType::kInt:
    case ValueType::kLevel:
      out.text = run.Keep(absl::StrCat(value.integer));
      break;
  }
  return EvalStatus::kValue;
}

// Of builtins that are no questions, by builtin.
constexpr EvalNode::Function kCalls[] = {
#define RIPS_BUILTIN(name, ...) &name,
#define RIPS_QUESTION(...) nullptr,
#include "policy_server/policy/lang/builtin.def"
};

// Of the number and the types that the signature asks for. What payload and plugin name has become
// EvalNode::index.
bool Fits(const lang::Signature& signature, const std::vector<const EvalNode*>& args) {
  if (signature.builtin == Builtin::kPayload || signature.builtin == Builtin::kPlugin) {
    return args.empty();
  }
  const size_t fixed = signature.parameters.size();
  if (signature.variadic() ? args.size() < fixed : args.size() != fixed) return false;
  for (size_t i = 0; i < args.size(); ++i) {
    const lang::Parameter& parameter = i < fixed ? signature.parameters[i] : signature.list;
    if (parameter.role == lang::ParameterRole::kAnyType) continue;
    if (PlainType(args[i]->type) != PlainType(parameter.type)) return false;
  }
  return true;
}

}  // namespace

EvalNode::Function TopicPredicateFunction() { return &TopicPredicate; }
EvalNode::Function FactsPredicateFunction() { return &FactsPredicate; }
EvalNode::Function GraphPredicateFunction() { return &GraphPredicate; }

EvalNode::Function CallFunction(Builtin builtin, const std::vector<const EvalNode*>& args) {
  // The checker turns `eval` into a comparison.
  if (builtin == Builtin::kEval || !Fits(lang::SignatureOf(builtin), args)) return nullptr;
  const Question* question = QuestionOf(builtin);
  if (question == nullptr) return kCalls[static_cast<size_t>(builtin)];
  // Patterns are compiled, and answered with the topic's verdict.
  if (question->form == Form::kMatches) return nullptr;
  return question->source == Source::kTopic ? &EvaluateTopicNow : &EvaluateNow;
}

}  // namespace rips::engine
