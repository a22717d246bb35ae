#include "policy_server/engine/interest.h"

#include <set>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/container/inlined_vector.h"
#include "absl/strings/str_cat.h"
#include "policy_server/engine/topic_verdicts.h"
#include "policy_server/lang/limits.h"
#include "re2/re2.h"

namespace rips::engine {
namespace {

using lang::BinaryOp;
using lang::Builtin;
using lang::TypedExpr;

// Topics of which an expression may be true, or may fault.
struct Topics {
  bool all = false;
  // Unless `all`: regexes.
  std::set<std::string> named;
  // One of them is a pattern that may match many.
  bool patterns = false;

  bool NarrowerThan(const Topics& other) const {
    if (all != other.all) return other.all;
    if (patterns != other.patterns) return other.patterns;
    return named.size() < other.named.size();
  }
};

bool Inspects(const TypedExpr& expr) {
  std::vector<const TypedExpr*> left = {&expr};
  while (!left.empty()) {
    const TypedExpr& at = *left.back();
    left.pop_back();
    if (at.kind == TypedExpr::Kind::kCall &&
        (at.builtin == Builtin::kPayload || at.builtin == Builtin::kPlugin)) {
      return true;
    }
    for (const TypedExpr& arg : at.args) left.push_back(&arg);
  }
  return false;
}

bool Inspects(const lang::TypedRule& rule) {
  if (Inspects(rule.condition)) return true;
  for (const lang::TypedChain& chain : rule.chains) {
    for (const lang::TypedAction& action : chain) {
      for (const TypedExpr& arg : action.args) {
        if (Inspects(arg)) return true;
      }
    }
  }
  return false;
}

const std::string* ConstantText(const TypedExpr& expr) {
  return expr.kind == TypedExpr::Kind::kConstant ? std::get_if<std::string>(&expr.constant)
                                                 : nullptr;
}

Topics OfCall(const TypedExpr& call) {
  const bool pattern = call.builtin == Builtin::kTopicMatches;
  if (!pattern && call.builtin != Builtin::kTopicIn) return {.all = true};
  if (pattern && call.args.size() != 1) return {.all = true};
  Topics topics{.patterns = pattern};
  for (const TypedExpr& arg : call.args) {
    const std::string* text = ConstantText(arg);
    if (text == nullptr) return {.all = true};
    topics.named.insert(pattern ? *text : absl::StrCat("^", RE2::QuoteMeta(*text), "$"));
  }
  return topics;
}

// The verdicts on topics (topic_verdicts.h) know of no other fault.
bool DividesByMaybeZero(const TypedExpr& expr) {
  if (expr.kind != TypedExpr::Kind::kBinary || expr.args.size() != 2) return false;
  if (expr.binary != BinaryOp::kDiv && expr.binary != BinaryOp::kMod) return false;
  const auto* divisor = std::get_if<int64_t>(&expr.args[1].constant);
  return expr.args[1].kind != TypedExpr::Kind::kConstant || divisor == nullptr || *divisor == 0;
}

bool MayFault(const TypedExpr& expr) {
  std::vector<const TypedExpr*> left = {&expr};
  while (!left.empty()) {
    const TypedExpr& at = *left.back();
    left.pop_back();
    if (DividesByMaybeZero(at)) return true;
    for (const TypedExpr& arg : at.args) left.push_back(&arg);
  }
  return false;
}

Topics OfLeaf(const TypedExpr& expr) {
  if (expr.kind == TypedExpr::Kind::kCall) return OfCall(expr);
  if (expr.kind != TypedExpr::Kind::kConstant) return {.all = true};
  const bool* value = std::get_if<bool>(&expr.constant);
  return {.all = value == nullptr || *value};
}

// What is known of a part of a condition.
struct Part {
  Topics topics;
  bool may_fault = false;
};

bool IsLogical(const TypedExpr& expr) {
  return expr.kind == TypedExpr::Kind::kBinary && expr.args.size() == 2 &&
         (expr.binary == BinaryOp::kAnd || expr.binary == BinaryOp::kOr);
}

Part PartOf(const TypedExpr& expr);

void Join(const TypedExpr& node, Part& left) {
  Part right = PartOf(node.args[1]);
  if (node.binary == BinaryOp::kOr) {
    left.topics.all |= right.topics.all;
    left.topics.patterns |= right.topics.patterns;
    left.topics.named.merge(right.topics.named);
    if (left.topics.all) left.topics.named.clear();
  } else if (!left.may_fault && right.topics.NarrowerThan(left.topics)) {
    // Where the right side is false the left side is evaluated all the same, and may fault.
    left.topics = std::move(right.topics);
  }
  left.may_fault |= right.may_fault;
}

Part PartOf(const TypedExpr& expr) {
  // The left side of a run of operators is followed without recursion.
  absl::InlinedVector<const TypedExpr*, 8> run;
  const TypedExpr* at = &expr;
  while (IsLogical(*at)) {
    run.push_back(at);
    at = &at->args[0];
  }
  Part part{.topics = OfLeaf(*at), .may_fault = MayFault(*at)};
  for (; !run.empty(); run.pop_back()) Join(*run.back(), part);
  return part;
}

// Can sensors hold these patterns?
bool Affordable(const std::set<std::string>& regexes) {
  if (regexes.size() > kInterestsMax) return false;
  size_t instructions = 0;
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(lang::kRegexBytesMax);
  for (const std::string& pattern : regexes) {
    const RE2 regex(pattern, options);
    // Refused for a name that is no UTF-8.
    if (!regex.ok()) return false;
    instructions += static_cast<size_t>(regex.ProgramSize());
    if (instructions > kInterestInstructionsMax) return false;
  }
  return true;
}

}  // namespace

std::vector<TopicInterest> PayloadInterest(const lang::CheckedRules& rules,
                                           uint32_t payload_bytes_max) {
  Topics needed;
  for (const lang::TypedRule& rule : rules.rules) {
    if (rule.section != lang::EventClass::kMsg || !Inspects(rule)) continue;
    if (NeverFires(rule.condition)) continue;
    Topics topics = PartOf(rule.condition).topics;
    needed.all |= topics.all;
    needed.named.merge(topics.named);
    needed.all |= needed.named.size() > kInterestsMax;
    if (needed.all) break;
  }
  if (!needed.all && needed.named.contains("")) needed.all = true;
  if (needed.all || !Affordable(needed.named)) return {{.payload_bytes_max = payload_bytes_max}};
  std::vector<TopicInterest> interests;
  interests.reserve(needed.named.size());
  for (const std::string& regex : needed.named) {
    interests.push_back({.topic_regex = regex, .payload_bytes_max = payload_bytes_max});
  }
  return interests;
}

}  // namespace rips::engine
