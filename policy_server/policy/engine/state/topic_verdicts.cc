#include "policy_server/policy/engine/state/topic_verdicts.h"

#include <algorithm>
#include <utility>

#include "absl/container/inlined_vector.h"

namespace rips::engine {
namespace {

using lang::BinaryOp;
using lang::TypedExpr;

enum class Truth { kFalse, kTrue, kUnknown };

// What an expression comes to where only some of its parts are known.
struct Forecast {
  // Its value if it does not fault.
  Truth value = Truth::kUnknown;
  bool may_fault = false;
};

Truth ToTruth(bool value) { return value ? Truth::kTrue : Truth::kFalse; }

class Forecaster {
 public:
  explicit Forecaster(KnownCall known) : known_(known) {}

  Forecast Of(const TypedExpr& expr) const {
    // The left side of a run of operators is followed without recursion.
    absl::InlinedVector<const TypedExpr*, 8> run;
    const TypedExpr* at = &expr;
    while (at->kind == TypedExpr::Kind::kBinary && at->args.size() == 2) {
      run.push_back(at);
      at = &at->args[0];
    }
    Forecast left = OfLeaf(*at);
    for (; !run.empty(); run.pop_back()) left = Join(*run.back(), left);
    return left;
  }

 private:
  Forecast OfLeaf(const TypedExpr& expr) const {
    if (expr.is_constant()) {
      const bool* value = std::get_if<bool>(&expr.constant);
      return {.value = value == nullptr ? Truth::kUnknown : ToTruth(*value)};
    }
    if (expr.kind == TypedExpr::Kind::kCall) {
      const std::optional<bool> holds = known_(expr);
      if (holds.has_value()) return {.value = ToTruth(*holds)};
    }
    Forecast out;
    for (const TypedExpr& arg : expr.args) {
      const Forecast part = Of(arg);
      out.may_fault |= part.may_fault;
      if (expr.kind == TypedExpr::Kind::kUnary && expr.unary == lang::UnaryOp::kNot &&
          part.value != Truth::kUnknown) {
        out.value = ToTruth(part.value == Truth::kFalse);
      }
    }
    return out;
  }

  Forecast Join(const TypedExpr& node, const Forecast& left) const {
    const bool is_and = node.binary == BinaryOp::kAnd;
    if (!is_and && node.binary != BinaryOp::kOr) {
      return {.may_fault = left.may_fault || Of(node.args[1]).may_fault || MayDivideByZero(node)};
    }
    // What decides the whole from either side, and what leaves it to the other.
    const Truth decisive = ToTruth(!is_and);
    const Truth neutral = ToTruth(is_and);
    if (left.value == decisive) return left;
    const Forecast right = Of(node.args[1]);
    const bool may_fault = left.may_fault || right.may_fault;
    if (right.value == decisive || left.value == neutral) {
      return {.value = right.value, .may_fault = may_fault};
    }
    return {.may_fault = may_fault};
  }

  KnownCall known_;
};

bool IsFalse(const Forecast& forecast) {
  return forecast.value == Truth::kFalse && !forecast.may_fault;
}

std::vector<bool> AllHolds(const CompiledPolicy& program, const EvalContext& scene) {
  const CompiledPolicy::Compiled& compiled = program.compiled();
  const std::vector<Predicate>& predicates = compiled.predicates;
  std::vector<bool> holds(predicates.size());
  const bool searched = compiled.patterns.Search(scene.topic, holds);
  for (size_t i = 0; i < predicates.size(); ++i) {
    if (!searched || predicates[i].regex == nullptr) holds[i] = Holds(predicates[i], scene);
  }
  return holds;
}

TopicVerdict Decide(const CompiledPolicy& program, std::vector<bool> holds) {
  const CompiledPolicy::Compiled& compiled = program.compiled();
  TopicVerdict verdict;
  const auto known = [&](const TypedExpr& call) -> std::optional<bool> {
    const auto predicate = compiled.predicate_of.find(&call);
    if (predicate == compiled.predicate_of.end()) return std::nullopt;
    return holds[predicate->second];
  };
  for (const uint32_t rule : compiled.message_rules) {
    if (NeverFires(program.rules().rules[rule].condition, known)) continue;
    verdict.rules.push_back(rule);
    const RuleNeeds& needs = compiled.needs[rule];
    if (needs.inspects) verdict.inspecting.push_back(rule);
    verdict.topic_window_ns = std::max(verdict.topic_window_ns, needs.topic_window_ns);
    verdict.sender_window_ns = std::max(verdict.sender_window_ns, needs.sender_window_ns);
  }
  verdict.holds = std::move(holds);
  return verdict;
}

}  // namespace

bool MayDivideByZero(const TypedExpr& expr) {
  if (expr.kind != TypedExpr::Kind::kBinary || expr.args.size() != 2) return false;
  if (expr.binary != BinaryOp::kDiv && expr.binary != BinaryOp::kMod) return false;
  const TypedExpr& divisor = expr.args[1];
  const auto* value = std::get_if<int64_t>(&divisor.constant);
  return !divisor.is_constant() || (value != nullptr && *value == 0);
}

bool Holds(const Predicate& predicate, const EvalContext& scene) {
  if (predicate.regex != nullptr) {
    return RE2::PartialMatch(re2::StringPiece(scene.topic.data(), scene.topic.size()),
                             *predicate.regex);
  }
  return Ask(predicate.builtin, predicate.args, scene).value_or(false);
}

bool NeverFires(const lang::TypedExpr& condition, KnownCall known) {
  return IsFalse(Forecaster(known).Of(condition));
}

bool NeverFires(const lang::TypedExpr& condition) {
  return NeverFires(condition, [](const TypedExpr&) { return std::nullopt; });
}

bool TopicVerdicts::Remembers(const EvalContext& scene) {
  return scene.types.size() <= kTypesMax && scene.topic.size() <= kNameBytesMax &&
         std::all_of(scene.types.begin(), scene.types.end(),
                     [](absl::string_view type) { return type.size() <= kNameBytesMax; });
}

const TopicVerdict& TopicVerdicts::For(const CompiledPolicy& program, const EvalContext& scene) {
  const auto known = topics_.find(scene.topic);
  if (known != topics_.end() && std::equal(known->second.types.begin(), known->second.types.end(),
                                           scene.types.begin(), scene.types.end())) {
    return *known->second.verdict;
  }

  std::vector<bool> holds = AllHolds(program, scene);
  if (!Remembers(scene)) {
    passing_ = Decide(program, std::move(holds));
    return passing_;
  }
  if ((known == topics_.end() && topics_.size() >= kTopicsMax) || verdicts_.size() >= kTopicsMax ||
      rules_ >= kRulesMax) {
    Clear();
  }
  std::unique_ptr<const TopicVerdict>& verdict = verdicts_[holds];
  if (verdict == nullptr) {
    verdict = std::make_unique<const TopicVerdict>(Decide(program, std::move(holds)));
    rules_ += verdict->rules.size();
  }
  Known& entry = topics_[scene.topic];
  entry.types = std::vector<std::string>(scene.types.begin(), scene.types.end());
  entry.verdict = verdict.get();
  return *entry.verdict;
}

void TopicVerdicts::Clear() {
  topics_.clear();
  verdicts_.clear();
  rules_ = 0;
  ++generation_;
}

}  // namespace rips::engine
