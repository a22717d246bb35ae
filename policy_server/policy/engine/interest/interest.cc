#include "policy_server/policy/engine/interest/interest.h"

#include <algorithm>
#include <array>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/container/flat_hash_map.h"
#include "absl/container/inlined_vector.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/state/topic_verdicts.h"
#include "policy_server/policy/lang/limits.h"
#include "policy_server/policy/lang/walk.h"
#include "re2/re2.h"

namespace rips::engine {
namespace {

using lang::BinaryOp;
using lang::Builtin;
using lang::TypedExpr;

constexpr std::array<const char*, 2> kOnlyIfNamed = {"/parameter_events", "/rosout"};

// Topics of which an expression may be true, or may fault.
struct Topics {
  bool all = false;
  // Unless `all`: names, and patterns that may match many.
  std::set<std::string> names;
  std::set<std::string> patterns;

  bool NarrowerThan(const Topics& other) const {
    if (all != other.all) return other.all;
    if (patterns.empty() != other.patterns.empty()) return patterns.empty();
    return names.size() + patterns.size() < other.names.size() + other.patterns.size();
  }
};

bool Inspects(const lang::TypedRule& rule) {
  bool inspects = false;
  lang::ForEachExpr(rule, [&](const TypedExpr& expr) {
    inspects |= expr.kind == TypedExpr::Kind::kCall &&
                (expr.builtin == Builtin::kPayload || expr.builtin == Builtin::kPlugin);
  });
  return inspects;
}

Topics OfCall(const TypedExpr& call) {
  const bool pattern = call.builtin == Builtin::kTopicMatches;
  if (!pattern && call.builtin != Builtin::kTopicIn) return {.all = true};
  if (pattern && call.args.size() != 1) return {.all = true};
  Topics topics;
  for (const TypedExpr& arg : call.args) {
    const std::string* text = arg.constant_text();
    if (text == nullptr) return {.all = true};
    (pattern ? topics.patterns : topics.names).insert(*text);
  }
  return topics;
}

bool MayFault(const TypedExpr& expr) {
  bool may_fault = false;
  lang::ForEachExpr(expr, [&](const TypedExpr& part) { may_fault |= MayDivideByZero(part); });
  return may_fault;
}

Topics OfLeaf(const TypedExpr& expr) {
  if (expr.kind == TypedExpr::Kind::kCall) return OfCall(expr);
  if (!expr.is_constant()) return {.all = true};
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
    left.topics.names.merge(right.topics.names);
    left.topics.patterns.merge(right.topics.patterns);
    if (left.topics.all) left.topics = {.all = true};
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

// Adds the literals of `expr`, if it is a call of `topicin`.
void AddLiterals(const TypedExpr& expr, std::set<std::string>& names) {
  if (expr.kind != TypedExpr::Kind::kCall || expr.builtin != Builtin::kTopicIn) return;
  for (const TypedExpr& arg : expr.args) {
    if (const std::string* text = arg.constant_text()) names.insert(*text);
  }
}

// A message rule that may fire or fault somewhere.
struct Wanting {
  const lang::TypedRule* rule;
  bool inspects;
  Topics topics;

  Depth depth() const { return inspects ? Depth::kPayload : Depth::kMetadata; }
};

std::unique_ptr<const RE2> Compile(const std::string& pattern) {
  RE2::Options options;
  options.set_log_errors(false);
  options.set_max_mem(lang::kRegexBytesMax);
  return std::make_unique<const RE2>(pattern, options);
}

std::string ExactRegex(const std::string& name) {
  return absl::StrCat("^", RE2::QuoteMeta(name), "$");
}

class Planner {
 public:
  Planner(const lang::CheckedRules& rules, uint32_t payload_bytes_max)
      : payload_bytes_max_(payload_bytes_max) {
    std::set<std::string> named;
    for (const lang::TypedRule& rule : rules.rules) {
      if (rule.section != lang::EventClass::kMsg || NeverFires(rule.condition)) continue;
      wanting_.push_back({&rule, Inspects(rule), PartOf(rule.condition).topics});
      lang::ForEachExpr(rule.condition,
                        [&](const TypedExpr& expr) { AddLiterals(expr, literals_); });
      lang::ForEachExpr(rule, [&](const TypedExpr& expr) { AddLiterals(expr, named); });
    }
    for (const char* topic : kOnlyIfNamed) {
      if (!named.contains(topic)) unnamed_.push_back(topic);
    }
  }

  InterestPlan Run() {
    if (wanting_.empty()) return {{.depth = Depth::kNothing}};
    InterestPlan plan = Precise();
    if (!plan.empty() && Affordable(plan)) return plan;
    plan = PayloadsOnly();
    if (!plan.empty() && Affordable(plan)) return plan;
    InterestPlan everything = Unnamed();
    everything.push_back(Row("", Deepest(), [](const Wanting&) { return true; }));
    return everything;
  }

 private:
  // Asks for exactly what is needed of each topic that is named, and of those that patterns and
  // rules about all topics leave. Empty if that is too much work.
  InterestPlan Precise() {
    if (literals_.size() > kInterestsMax ||
        literals_.size() * wanting_.size() > kInterestForecastsMax) {
      return {};
    }
    InterestPlan rest = Patterns(Depth::kPayload);
    InterestPlan metadata = Patterns(Depth::kMetadata);
    std::move(metadata.begin(), metadata.end(), std::back_inserter(rest));
    const Depth default_depth = DefaultDepth();
    // What the last one asks for anyway.
    rest.erase(std::remove_if(rest.begin(), rest.end(),
                              [&](const TopicInterest& row) { return row.depth <= default_depth; }),
               rest.end());
    rest.push_back(Row("", default_depth, [&](const Wanting& each) {
      return each.topics.all || each.depth() <= default_depth;
    }));
    InterestPlan plan;
    for (const std::string& topic : unnamed_) {
      if (FirstMatch(rest, topic).depth != Depth::kNothing) plan.push_back(Nothing(topic));
    }
    for (const std::string& name : literals_) {
      TopicInterest row = OfName(name);
      TopicInterest& otherwise = FirstMatch(rest, name);
      if (row.depth == otherwise.depth) {
        AddReasons(row.wanted_by, otherwise.wanted_by);
      } else {
        plan.push_back(std::move(row));
      }
    }
    std::move(rest.begin(), rest.end(), std::back_inserter(plan));
    return plan;
  }

  // Asks for metadata of everything, and for the payloads that are needed.
  InterestPlan PayloadsOnly() const {
    if (DefaultDepth() == Depth::kPayload) return {};
    InterestPlan plan = Unnamed();
    std::set<std::string> names;
    for (const Wanting& each : wanting_) {
      if (each.inspects) names.insert(each.topics.names.begin(), each.topics.names.end());
    }
    if (names.size() > kInterestsMax) return {};
    for (const std::string& name : names) {
      plan.push_back(Row(ExactRegex(name), Depth::kPayload, [&](const Wanting& each) {
        return each.inspects && each.topics.names.contains(name);
      }));
    }
    InterestPlan patterns = Patterns(Depth::kPayload);
    std::move(patterns.begin(), patterns.end(), std::back_inserter(plan));
    plan.push_back(Row("", Depth::kMetadata, [](const Wanting& each) { return !each.inspects; }));
    return plan;
  }

  InterestPlan Unnamed() const {
    InterestPlan plan;
    for (const std::string& topic : unnamed_) plan.push_back(Nothing(topic));
    return plan;
  }
  static TopicInterest Nothing(const std::string& topic) {
    return {.topic_regex = ExactRegex(topic), .depth = Depth::kNothing};
  }

  // Of the rules of that depth that are not about all topics.
  InterestPlan Patterns(Depth depth) const {
    std::set<std::string> patterns;
    for (const Wanting& each : wanting_) {
      if (each.depth() != depth || each.topics.all) continue;
      patterns.insert(each.topics.patterns.begin(), each.topics.patterns.end());
    }
    InterestPlan plan;
    for (const std::string& pattern : patterns) {
      plan.push_back(Row(pattern, depth, [&](const Wanting& each) {
        return !each.topics.all && each.depth() == depth && each.topics.patterns.contains(pattern);
      }));
      // Every topic: the rest need not be told.
      if (pattern.empty()) break;
    }
    return plan;
  }

  // What the rules need of the topic of that very name.
  TopicInterest OfName(const std::string& name) {
    const auto known = [&](const TypedExpr& call) -> std::optional<bool> {
      const bool pattern = call.builtin == Builtin::kTopicMatches;
      if (!pattern && call.builtin != Builtin::kTopicIn) return std::nullopt;
      bool holds = false;
      for (const TypedExpr& arg : call.args) {
        const std::string* text = arg.constant_text();
        if (text == nullptr) return std::nullopt;
        holds |= pattern ? Matches(*text, name) : *text == name;
      }
      return holds;
    };
    std::set<const lang::TypedRule*> may_fire;
    Depth depth = Depth::kNothing;
    for (const Wanting& each : wanting_) {
      if (NeverFires(each.rule->condition, known)) continue;
      may_fire.insert(each.rule);
      depth = std::max(depth, each.depth());
    }
    return Row(ExactRegex(name), depth,
               [&](const Wanting& each) { return may_fire.contains(each.rule); });
  }

  Depth DefaultDepth() const {
    Depth depth = Depth::kNothing;
    for (const Wanting& each : wanting_) {
      if (each.topics.all) depth = std::max(depth, each.depth());
    }
    return depth;
  }
  Depth Deepest() const {
    Depth depth = Depth::kNothing;
    for (const Wanting& each : wanting_) depth = std::max(depth, each.depth());
    return depth;
  }

  template <typename Wants>
  TopicInterest Row(std::string regex, Depth depth, const Wants& wants) const {
    TopicInterest row{.topic_regex = std::move(regex),
                      .depth = depth,
                      .payload_bytes_max = depth == Depth::kPayload ? payload_bytes_max_ : 0};
    std::vector<std::string> names;
    for (const Wanting& each : wanting_) {
      if (wants(each)) names.push_back(each.rule->name);
    }
    AddReasons(names, row.wanted_by);
    return row;
  }

  static void AddReasons(const std::vector<std::string>& names, std::vector<std::string>& to) {
    to.insert(to.end(), names.begin(), names.end());
    std::sort(to.begin(), to.end());
    to.erase(std::unique(to.begin(), to.end()), to.end());
    if (to.size() > kWantedByMax) to.resize(kWantedByMax);
  }

  bool Matches(const std::string& pattern, const std::string& name) {
    std::unique_ptr<const RE2>& regex = compiled_[pattern];
    if (regex == nullptr) regex = Compile(pattern);
    // What is no pattern is taken to match.
    return !regex->ok() || RE2::PartialMatch(name, *regex);
  }
  // The last row matches.
  TopicInterest& FirstMatch(InterestPlan& rows, const std::string& name) {
    return *std::find_if(rows.begin(), rows.end(), [&](const TopicInterest& row) {
      return row.topic_regex.empty() || Matches(row.topic_regex, name);
    });
  }

  // Can sensors hold these patterns?
  bool Affordable(const InterestPlan& plan) {
    if (plan.size() > kInterestsMax) return false;
    size_t instructions = 0;
    for (const TopicInterest& row : plan) {
      const std::unique_ptr<const RE2> regex = Compile(row.topic_regex);
      // Refused for a name that is no UTF-8.
      if (!regex->ok()) return false;
      instructions += static_cast<size_t>(regex->ProgramSize());
      if (instructions > kInterestInstructionsMax) return false;
    }
    return true;
  }

  uint32_t payload_bytes_max_;
  std::vector<Wanting> wanting_;
  // That conditions name.
  std::set<std::string> literals_;
  std::vector<std::string> unnamed_;
  absl::flat_hash_map<std::string, std::unique_ptr<const RE2>> compiled_;
};

}  // namespace

InterestPlan PlanInterest(const lang::CheckedRules& rules, uint32_t payload_bytes_max) {
  return Planner(rules, payload_bytes_max).Run();
}

}  // namespace rips::engine
