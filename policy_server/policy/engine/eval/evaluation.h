// One event under one program, and the evaluation of expressions on it.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_EVAL_EVALUATION_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_EVAL_EVALUATION_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/policy/engine/builtins/scalar.h"
#include "policy_server/policy/engine/state/code.h"
#include "policy_server/policy/engine/state/compiled.h"
#include "policy_server/policy/engine/state/event.h"
#include "policy_server/policy/engine/state/robot_state.h"
#include "policy_server/policy/engine/state/topic_cache.h"
#include "services/base/clock.h"

namespace rips::engine {

// Where the values of a program's variables stand, by the program's own index.
class Variables {
 public:
  Variables() = default;
  // Of an older one: each stands somewhere else.
  explicit Variables(std::vector<const lang::Value*> places) : places_(std::move(places)) {}

  // Of the program in force.
  void Use(const std::vector<lang::Value>& values) { values_ = &values; }

  // Null if there is no such variable.
  const lang::Value* Find(size_t index) const {
    if (values_ != nullptr) return index < values_->size() ? &(*values_)[index] : nullptr;
    return index < places_.size() ? places_[index] : nullptr;
  }

 private:
  const std::vector<lang::Value>* values_ = nullptr;
  std::vector<const lang::Value*> places_;
};

// What nodes are evaluated on, and what is learnt on the way. Borrows all that it points to.
//
// Truth of `a && b` and `a || b` (T true, F false, ? not known, ! fault, - not evaluated):
//
//   a  b  a && b  a || b        a  b  a && b  a || b        a  b  a && b  a || b
//   T  T  T       T (b -)       F  T  F (b -) T             ?  T  ?       T
//   T  F  F       T (b -)       F  F  F (b -) F             ?  F  F       ?
//   T  ?  ?       T (b -)       F  ?  F (b -) ?             ?  ?  ?       ?
//   T  !  !       T (b -)       F  !  F (b -) !             ?  !  !       !
//                                                           !  -  !       !
//
// Anything else that is not known in an operand makes the whole not known; a fault that is
// evaluated, a fault.
struct Evaluation {
  const CompiledPolicy* program = nullptr;
  const CompiledPolicy::Compiled* compiled = nullptr;
  const RobotState* state = nullptr;
  // Null for events of other kinds.
  const MessageEvent* message = nullptr;
  const ExternalEvent* external = nullptr;
  // What is remembered of the message's topic and of the graph. Null: decided afresh.
  TopicEntry* topic = nullptr;
  Answers* graph_answers = nullptr;
  EvalContext scene;
  Variables variables;
  int64_t time_ns = 0;
  int64_t uptime_ns = 0;
  size_t string_max = 0;
  // `CurrLevel`, in the program's table, and `Level`.
  levels::LevelIndex level = 0;
  absl::string_view level_name;
  absl::string_view rule_name;

  // Only what cannot change before the message is judged is known: its topic, type, sender and
  // size. Inspections that may be asked are added to `asked`.
  bool foreseeing = false;
  std::vector<uint32_t>* asked = nullptr;

  // Of the last evaluation that faulted, for people.
  absl::string_view fault;
  // What was left out of the graph may turn an answer that was given.
  bool graph_open = false;
  // A string was longer than string_max and has been cut.
  bool cut = false;
  // Nodes evaluated.
  uint64_t steps = 0;
  // Strings made; views point into them, which therefore stay where they are.
  std::vector<std::unique_ptr<const std::string>> texts;

  explicit Evaluation(const ros2::RosGraph& graph) : scene({.graph = graph}) {}
  Evaluation(const Evaluation&) = delete;
  Evaluation& operator=(const Evaluation&) = delete;

  EvalStatus Fault(absl::string_view what) {
    fault = what;
    return EvalStatus::kFault;
  }
  EvalStatus LeftOpen() {
    graph_open = true;
    return EvalStatus::kUnscanned;
  }
  // Keeps `text`, cut to the limit.
  absl::string_view Keep(std::string text);
};

inline EvalStatus Eval(const EvalNode& node, Evaluation& run, Slot& out) {
  ++run.steps;
  return node.function(node, run, out);
}

// A value of that type as what it is to people and to builtins, and its own copy.
Scalar ToScalar(const Slot& cell, lang::ValueType type);
lang::Value Own(const Slot& cell, lang::ValueType type);

// Functions of nodes, by what they do. Null if the operator does not take such operands.
EvalNode::Function ConstantFunction();
EvalNode::Function VariableFunction(lang::ValueType type);
EvalNode::Function PredefinedFunction(lang::Predefined name);
EvalNode::Function UnaryFunction(lang::UnaryOp op, lang::ValueType operand);
// `constant_right`: the right operand is EvalNode::constant.
EvalNode::Function BinaryFunction(lang::BinaryOp op, lang::ValueType operand, bool constant_right);
// Predicates, by what they depend on; EvalNode::index is theirs.
EvalNode::Function TopicPredicateFunction();
EvalNode::Function FactsPredicateFunction();
EvalNode::Function GraphPredicateFunction();
// Every other call. Null if the arguments do not fit.
EvalNode::Function CallFunction(lang::Builtin builtin, const std::vector<const EvalNode*>& args);

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_EVAL_EVALUATION_H_
