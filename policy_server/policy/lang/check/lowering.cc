#include "policy_server/policy/lang/check/lowering.h"

#include <algorithm>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/check/fold.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/limits.h"
#include "services/text/quote.h"

namespace rips::lang {
namespace {

// Bit i: level i.
using LevelSet = uint64_t;
static_assert(kLevelsMax <= 64, "LevelSet has 64 bits");

LevelSet Bit(int level) { return LevelSet{1} << level; }

// At which levels a bool expression may be true or false, and at which of them it may be so by the
// level and the time alone, whatever the variables and the answers of builtins are.
struct Truth {
  LevelSet may_be_true = 0;
  LevelSet may_be_false = 0;
  LevelSet true_alone = 0;
  LevelSet false_alone = 0;
};

// A part of an expression at one level.
struct Known {
  enum class Kind { kValue, kTime, kAnything };
  Kind kind = Kind::kAnything;
  Value value;  // kValue
};

Known Unknown(const std::vector<Known>& parts) {
  const bool anything = std::any_of(parts.begin(), parts.end(), [](const Known& part) {
    return part.kind == Known::Kind::kAnything;
  });
  return {.kind = anything ? Known::Kind::kAnything : Known::Kind::kTime, .value = {}};
}

bool IsAboutAnEvent(Builtin builtin) {
  return SignatureOf(builtin).event_class == EventClass::kExternal;
}

bool AsksLevel(const TypedExpr& expr) {
  if (expr.kind == TypedExpr::Kind::kPredefined) {
    return expr.predefined == Predefined::kCurrLevel || expr.predefined == Predefined::kLevel;
  }
  return std::any_of(expr.args.begin(), expr.args.end(), AsksLevel);
}

class Analysis {
 public:
  enum class When {
    kEver,
    kOnATick,     // there is no event: a question about one is answered with no
    kEachStands,  // a finding of each kind does
    kForNone,     // the same, and no part is true because of that: `!findingstands` is not, either
  };

  Analysis(const levels::LevelTable& levels, When when)
      : levels_(levels),
        when_(when),
        all_(levels.size() == 64 ? ~LevelSet{0} : (LevelSet{1} << levels.size()) - 1) {}

  LevelSet all() const { return all_; }

  // `negated`: behind an odd number of `!`.
  Truth TruthOf(const TypedExpr& expr, bool negated = false) const {
    if (expr.kind == TypedExpr::Kind::kUnary && expr.unary == UnaryOp::kNot) {
      return Not(TruthOf(expr.args[0], !negated));
    }
    if (const std::optional<Compared> compared = WithConstant(expr)) {
      if (compared->same) return TruthOf(*compared->with, negated);
      return Not(TruthOf(*compared->with, !negated));
    }
    if (expr.kind == TypedExpr::Kind::kBinary && expr.binary == BinaryOp::kAnd) {
      const Truth left = TruthOf(expr.args[0], negated), right = TruthOf(expr.args[1], negated);
      return {.may_be_true = left.may_be_true & right.may_be_true,
              .may_be_false = left.may_be_false | right.may_be_false,
              .true_alone = left.true_alone & right.true_alone,
              .false_alone = left.false_alone | right.false_alone};
    }
    if (expr.kind == TypedExpr::Kind::kBinary && expr.binary == BinaryOp::kOr) {
      const Truth left = TruthOf(expr.args[0], negated), right = TruthOf(expr.args[1], negated);
      return {.may_be_true = left.may_be_true | right.may_be_true,
              .may_be_false = left.may_be_false & right.may_be_false,
              .true_alone = left.true_alone | right.true_alone,
              .false_alone = left.false_alone & right.false_alone};
    }
    if (expr.kind == TypedExpr::Kind::kCall) {
      if (when_ == When::kOnATick && IsAboutAnEvent(expr.builtin)) {
        return {.may_be_true = all_, .may_be_false = all_, .false_alone = all_};
      }
      if (when_ >= When::kEachStands && expr.builtin == Builtin::kFindingStands) {
        const bool stands = when_ == When::kEachStands || negated;
        return stands ? Truth{.may_be_true = all_} : Truth{.may_be_false = all_};
      }
    }
    return TruthOfPart(expr);
  }

 private:
  struct Compared {
    const TypedExpr* with = nullptr;
    bool same = false;
  };

  static Truth Not(const Truth& of) {
    return {.may_be_true = of.may_be_false,
            .may_be_false = of.may_be_true,
            .true_alone = of.false_alone,
            .false_alone = of.true_alone};
  }

  // `x == true` and its like.
  static std::optional<Compared> WithConstant(const TypedExpr& expr) {
    if (expr.kind != TypedExpr::Kind::kBinary) return std::nullopt;
    if (expr.binary != BinaryOp::kEq && expr.binary != BinaryOp::kNe) return std::nullopt;
    for (const size_t i : {0, 1}) {
      const TypedExpr& constant = expr.args[i];
      if (!constant.is_constant() || constant.type != ValueType::kBool) continue;
      const bool value = std::get<bool>(constant.constant);
      return Compared{&expr.args[1 - i], value == (expr.binary == BinaryOp::kEq)};
    }
    return std::nullopt;
  }

  // Of what is not joined by `!`, `&&` and `||`.
  Truth TruthOfPart(const TypedExpr& expr) const {
    Truth out;
    if (!AsksLevel(expr)) {
      Add(At(expr, 0), all_, out);
    } else {
      for (int level = 0; level < levels_.size(); ++level) Add(At(expr, level), Bit(level), out);
    }
    return out;
  }

  static void Add(const Known& known, LevelSet where, Truth& out) {
    const bool is_value = known.kind == Known::Kind::kValue;
    const bool alone = known.kind != Known::Kind::kAnything;
    if (!is_value || std::get<bool>(known.value)) {
      out.may_be_true |= where;
      if (alone) out.true_alone |= where;
    }
    if (!is_value || !std::get<bool>(known.value)) {
      out.may_be_false |= where;
      if (alone) out.false_alone |= where;
    }
  }

  Known At(const TypedExpr& expr, int level) const {
    switch (expr.kind) {
      case TypedExpr::Kind::kConstant:
        return {.kind = Known::Kind::kValue, .value = expr.constant};
      case TypedExpr::Kind::kVariable:
        return {};
      case TypedExpr::Kind::kPredefined:
        return PredefinedAt(expr.predefined, level);
      case TypedExpr::Kind::kUnary:
      case TypedExpr::Kind::kBinary:
        return OperationAt(expr, level);
      case TypedExpr::Kind::kCall:
        if (expr.builtin != Builtin::kLevelName && expr.builtin != Builtin::kString) return {};
        return Unknown({At(expr.args[0], level)});
    }
    return {};
  }

  Known PredefinedAt(Predefined name, int level) const {
    switch (name) {
      case Predefined::kCurrLevel:
        return {.kind = Known::Kind::kValue, .value = int64_t{level}};
      case Predefined::kLevel:
        return {.kind = Known::Kind::kValue, .value = levels_.name(level)};
      case Predefined::kTime:
      case Predefined::kUptime:
      case Predefined::kCurrRule:
      case Predefined::kRobot:
        return {.kind = Known::Kind::kTime, .value = {}};
      case Predefined::kTopic:
      case Predefined::kMsgType:
      case Predefined::kSender:
      case Predefined::kSenderGuid:
      case Predefined::kIdsSource:
      case Predefined::kIdsTarget:
        break;
    }
    return {};
  }

  Known OperationAt(const TypedExpr& expr, int level) const {
    std::vector<Known> parts;
    for (const TypedExpr& arg : expr.args) parts.push_back(At(arg, level));
    for (const Known& part : parts) {
      if (part.kind != Known::Kind::kValue) return Unknown(parts);
    }
    if (expr.kind == TypedExpr::Kind::kUnary) {
      return {.kind = Known::Kind::kValue, .value = Fold(expr.unary, parts[0].value)};
    }
    // Texts are not built: runs of them could grow large.
    if (expr.binary == BinaryOp::kAdd && expr.type == ValueType::kString) return Unknown(parts);
    std::optional<Value> value = Fold(expr.binary, parts[0].value, parts[1].value);
    if (!value) return Unknown(parts);
    return {.kind = Known::Kind::kValue, .value = *std::move(value)};
  }

  const levels::LevelTable& levels_;
  const When when_;
  const LevelSet all_;
};

class Lowerings {
 public:
  Lowerings(const CheckedRules& rules, const std::vector<uint64_t>& variable_levels,
            DiagnosticSink& sink)
      : rules_(rules),
        variable_levels_(variable_levels),
        sink_(sink),
        analysis_(rules.levels, Analysis::When::kEver),
        ticking_(rules.levels, Analysis::When::kOnATick),
        each_stands_(rules.levels, Analysis::When::kEachStands),
        for_none_(rules.levels, Analysis::When::kForNone) {}

  void Warn(const TypedRule& rule) {
    const auto triggers = [](const TypedChain& chain) {
      return std::any_of(chain.begin(), chain.end(), [](const TypedAction& action) {
        return action.kind == ActionKind::kTrigger;
      });
    };
    if (std::none_of(rule.chains.begin(), rule.chains.end(), triggers)) return;
    const Truth truth = analysis_.TruthOf(rule.condition);
    if (truth.may_be_true == 0) return;
    // Where the level may be when a chain begins: chains before it may have moved it.
    const Places begin = {.at = truth.may_be_true,
                          .alone = truth.true_alone,
                          .on_a_tick = ticking_.TruthOf(rule.condition).true_alone,
                          .on_findings = each_stands_.TruthOf(rule.condition).may_be_true &
                                         ~for_none_.TruthOf(rule.condition).may_be_true};
    Places places = begin;
    for (const TypedChain& chain : rule.chains) {
      Places here = places;
      for (const TypedAction& action : chain) {
        if (action.kind == ActionKind::kTrigger) {
          const LevelSet targets = TargetsOf(action.args[0]);
          WarnTrigger(action, targets, here);
          places = places.Or(targets);
        }
        if (action.kind == ActionKind::kTrigger || action.kind == ActionKind::kExec) {
          here = begin.Or(analysis_.all());
        }
      }
    }
  }

 private:
  // Levels at which a trigger may run; those where nothing else was asked, or nothing but that
  // there is no event; and those where it runs because findings stand.
  struct Places {
    LevelSet at = 0;
    LevelSet alone = 0;
    LevelSet on_a_tick = 0;
    LevelSet on_findings = 0;

    // Elsewhere, or later.
    Places Or(LevelSet more) const {
      return {at | more, alone == 0 ? 0 : alone | more, on_a_tick == 0 ? 0 : on_a_tick | more, 0};
    }
  };

  // None for `CurrLevel`, which changes nothing.
  LevelSet TargetsOf(const TypedExpr& level) const {
    if (level.is_constant()) {
      return Bit(static_cast<int>(std::get<int64_t>(level.constant)));
    }
    if (level.kind != TypedExpr::Kind::kVariable) return 0;
    return variable_levels_[level.variable] & analysis_.all();
  }

  void WarnTrigger(const TypedAction& trigger, LevelSet targets, const Places& here) {
    bool acts = false;
    std::optional<std::pair<int, int>> refused;  // from, to
    for (int from = 0; from < rules_.levels.size(); ++from) {
      if ((here.at & Bit(from)) == 0) continue;
      for (int to = 0; to < rules_.levels.size(); ++to) {
        if ((targets & Bit(to)) == 0) continue;
        const bool lowers = to == from - 1 && rules_.levels.at(from).soft;
        if (lowers && ((here.alone | here.on_a_tick) & Bit(from)) != 0) {
          return WarnUnguarded(trigger.range, from, (here.alone & Bit(from)) != 0);
        }
        if (lowers && (here.on_findings & Bit(from)) != 0) {
          return WarnOnFindings(trigger.range, from, (here.at & (Bit(to) - 1)) != 0 ? to : -1);
        }
        acts = acts || lowers || to > from;
        if (to < from && !lowers && !refused) refused = {from, to};
      }
    }
    if (!acts && refused) WarnNever(trigger.range, refused->first, refused->second);
  }

  void WarnUnguarded(SourceRange range, int from, bool alone) {
    const std::string level = rules_.levels.name(from);
    sink_.Add(DiagnosticKind::kUnguardedLowering, range,
              absl::StrCat("this leaves level ", Quote(level),
                           " although what raised it may still be there: the rule asks for nothing "
                           "but the level and the time",
                           alone ? "" : ", and that no event comes, which is so at the next tick"),
              absl::StrCat("ask that it is over, as in `CurrLevel == ", level,
                           alone ? " && !intruder`, with a variable that other rules set"
                                 : " && !findingstands(\"any\")`"));
  }

  // `raises_to`: at other levels it raises to that one; negative = it does not.
  void WarnOnFindings(SourceRange range, int from, int raises_to) {
    sink_.Add(DiagnosticKind::kUnguardedLowering, range,
              absl::StrCat("this leaves level ", Quote(rules_.levels.name(from)),
                           " because a finding stands"),
              raises_to < 0 ? "ask instead, with `!findingstands(...)`, that what raised it is over"
                            : absl::StrCat("if it is to raise the level, ask `CurrLevel < ",
                                           rules_.levels.name(raises_to), "`, too"));
  }

  void WarnNever(SourceRange range, int from, int to) {
    const std::string level = rules_.levels.name(from);
    const std::string refused =
        absl::StrCat("this `trigger` changes nothing and is refused at level ", Quote(level));
    if (from - to > 1) {
      sink_.Add(DiagnosticKind::kNeverLowers, range,
                absl::StrCat(refused, ": ", Quote(rules_.levels.name(to)), " is ", from - to,
                             " steps below"),
                "rules go down one step at a time, from soft levels");
      return;
    }
    sink_.Add(DiagnosticKind::kNeverLowers, range, absl::StrCat(refused, ", which is not soft"),
              absl::StrCat("declare `", level,
                           " soft` if rules may leave it downwards; else a person does it with "
                           "`ripsctl level lower`"));
  }

  const CheckedRules& rules_;
  const std::vector<uint64_t>& variable_levels_;
  DiagnosticSink& sink_;
  const Analysis analysis_;
  const Analysis ticking_;
  const Analysis each_stands_;
  const Analysis for_none_;
};

}  // namespace

void WarnLowerings(const CheckedRules& rules, const std::vector<uint64_t>& variable_levels,
                   DiagnosticSink& sink) {
  Lowerings lowerings(rules, variable_levels, sink);
  for (const TypedRule& rule : rules.rules) lowerings.Warn(rule);
}

}  // namespace rips::lang
