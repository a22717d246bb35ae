// Expressions as the evaluator runs them: a tree of nodes whose types and names are fixed, each
// with the function that evaluates it.
#ifndef RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_CODE_H_
#define RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_CODE_H_

#include <cstdint>
#include <deque>
#include <vector>

#include "absl/strings/string_view.h"
#include "policy_server/policy/lang/checked_rules.h"

namespace rips::engine {

struct Evaluation;

// What became of an evaluation. Where two operands do not know, the later one in this order is
// told; a fault always is.
enum class EvalStatus : uint8_t {
  kValue,
  // An inspection was not told the answer.
  kUnscanned,
  // The recording does not hold what was asked.
  kUndecidable,
  kFault,
};

// A value whose type the checker has fixed; a level is an integer.
struct Slot {
  Slot() : integer(0) {}
  union {
    int64_t integer;
    double real;
    bool truth;
    // Lives in the rules, in a variable, in the event or in the Evaluation that made it.
    absl::string_view text;
  };
};

struct EvalNode {
  using Function = EvalStatus (*)(const EvalNode& node, Evaluation& run, Slot& out);

  Function function = nullptr;
  const EvalNode* left = nullptr;
  const EvalNode* right = nullptr;
  // A constant, or the constant right operand.
  Slot constant;
  // Of a variable, a predicate or an inspection; how far a count looks back, in nanoseconds.
  int64_t index = 0;
  lang::Builtin builtin = lang::Builtin::kEval;
  // The integer kind of a level too.
  lang::ValueType type = lang::ValueType::kBool;
  // Of calls that are not decided beforehand.
  std::vector<const EvalNode*> args;
};

// Owns nodes; pointers to them stay valid.
using Code = std::deque<EvalNode>;

}  // namespace rips::engine

#endif  // RIPS_POLICY_SERVER_POLICY_ENGINE_STATE_CODE_H_
