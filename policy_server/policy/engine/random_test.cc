// Seeded random programs and event streams: nothing crashes, and the same input gives the same
// output, whatever is remembered on the way.
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

constexpr uint32_t kInt = 0;
constexpr uint32_t kFloat = 1;
constexpr uint32_t kBool = 2;
constexpr uint32_t kString = 3;

// Well-typed rules over one variable of each type.
class Generator {
 public:
  explicit Generator(uint32_t seed) : random_(seed) {}

  std::shared_ptr<const CompiledPolicy> Rules() {
    TestRules rules;
    rules.IntVar("i", 0);
    rules.Var("f", ValueType::kFloat, 0.5);
    rules.Var("b", ValueType::kBool, false);
    rules.Var("s", ValueType::kString, std::string("s"));
    for (int i = 0; i < 12; ++i) {
      const EventClass section =
          std::vector{EventClass::kMsg, EventClass::kGraph, EventClass::kExternal}[Pick(3)];
      std::vector<TypedChain> chains;
      for (size_t c = 0; c <= Pick(3); ++c) chains.push_back(Chain());
      rules.Rule(section, absl::StrCat("r", i), Bool(4), std::move(chains));
    }
    return rules.Build();
  }

  size_t Pick(size_t n) { return random_() % n; }

 private:
  std::string Word() { return std::vector<std::string>{"/a", "/b", "a", "/x/a", ""}[Pick(5)]; }
  Exprs Words() {
    Exprs out;
    for (size_t i = 0; i < Pick(4); ++i) out.push_back(S(Word()));
    return out;
  }
  BinaryOp Order() { return static_cast<BinaryOp>(static_cast<size_t>(BinaryOp::kEq) + Pick(6)); }

  TypedExpr Int(int depth) {
    constexpr BinaryOp kOps[] = {BinaryOp::kAdd,   BinaryOp::kSub,   BinaryOp::kMul,
                                 BinaryOp::kDiv,   BinaryOp::kMod,   BinaryOp::kBitAnd,
                                 BinaryOp::kBitOr, BinaryOp::kBitXor};
    switch (depth <= 0 ? Pick(4) : Pick(7)) {
      case 0:
        return I(static_cast<int64_t>(Pick(5)) - 2);
      case 1:
        return I(Pick(2) == 0 ? std::numeric_limits<int64_t>::min()
                              : std::numeric_limits<int64_t>::max());
      case 2:
        return V(kInt);
      case 3:
        return Name(Pick(2) == 0 ? Predefined::kCurrLevel : Predefined::kTime);
      case 4:
        return Op(Pick(2) == 0 ? UnaryOp::kMinus : UnaryOp::kComplement, Int(depth - 1));
      default:
        return Op(Int(depth - 1), kOps[Pick(8)], Int(depth - 1));
    }
  }
  TypedExpr Float(int depth) {
    constexpr BinaryOp kOps[] = {BinaryOp::kAdd, BinaryOp::kSub, BinaryOp::kMul, BinaryOp::kDiv};
    if (depth <= 0) return Pick(2) == 0 ? V(kFloat) : F(static_cast<double>(Pick(5)) - 2);
    return Op(Float(depth - 1), kOps[Pick(4)], Float(depth - 1));
  }
  TypedExpr String(int depth) {
    switch (depth <= 0 ? Pick(3) : Pick(6)) {
      case 0:
        return V(kString);
      case 1:
        return S(Word());
      case 2:
        return Name(Pick(2) == 0 ? Predefined::kLevel : Predefined::kCurrRule);
      case 3:
        return Text(Pick(2) == 0 ? Int(depth - 1) : Float(depth - 1));
      case 4:
        return Call(Builtin::kLevelName, {Int(depth - 1)});
      default:
        return Concat(String(depth - 1), String(depth - 1));
    }
  }
  TypedExpr Bool(int depth) {
    switch (depth <= 0 ? Pick(3) : Pick(12)) {
      case 0:
        return B(Pick(2) == 0);
      case 1:
        return V(kBool);
      case 2:
        return Call(Builtin::kTopicIn, Words());
      case 3:
        return Call(Builtin::kTopicMatches, {S(Word())});
      case 4:
        return Call(std::vector{Builtin::kNodes, Builtin::kNodesInclude, Builtin::kPublishers,
                                Builtin::kSubscribersInclude, Builtin::kMsgTypeIn}[Pick(5)],
                    Words());
      case 5:
        return Call(Builtin::kPublisherCount, {Int(depth - 1), Int(depth - 1)});
      case 6:
        return Op(Int(depth - 1), Order(), Int(depth - 1));
      case 7:
        return Op(Float(depth - 1), Order(), Float(depth - 1));
      case 8:
        return Op(String(depth - 1), Order(), String(depth - 1));
      case 9:
        return Not(Bool(depth - 1));
      case 10:
        return And(Bool(depth - 1), Bool(depth - 1));
      default:
        return Or(Bool(depth - 1), Bool(depth - 1));
    }
  }
  TypedAction Action() {
    switch (Pick(7)) {
      case 0:
        return Alert(String(2));
      case 1:
        return Set(kInt, Int(2));
      case 2:
        return Set(kFloat, Float(2));
      case 3:
        return Set(kBool, Bool(2));
      case 4:
        return Set(kString, String(2));
      case 5:
        return Exec({"p", Word()});
      default:
        return Trigger(static_cast<int64_t>(Pick(4)));
    }
  }
  TypedChain Chain() {
    TypedChain chain;
    const size_t size = 1 + Pick(4);
    for (size_t i = 0; i < size; ++i) {
      chain.push_back(Action() >> (i + 1 == size ? Connector::kEnd
                                                 : std::vector{kThen, kElse, kAnyway}[Pick(3)]));
    }
    return chain;
  }

  std::mt19937 random_;
};

// Everything that came out of `steps` random events, as text.
std::string Play(uint32_t seed, bool forget) {
  Generator generator(seed);
  const std::shared_ptr<const CompiledPolicy> program = generator.Rules();
  TestRobot robot(program);
  const ros2::RosGraph graphs[] = {
      ros2::RosGraph(), TestGraph().Node("/a").Publishes("/a", "/a").Build(),
      TestGraph().Node("/a").Node("/x/a").Publishes("/a", "/b").Subscribes("/x/a", "/b").Build()};
  std::vector<std::string> log;
  for (int step = 0; step < 200; ++step) {
    robot.Advance(static_cast<int64_t>(generator.Pick(400)) * kNanosPerMilli);
    const levels::LevelIndex before = robot.state.level.level();
    Outcome outcome;
    switch (generator.Pick(8)) {
      case 0:
        robot.state.graph = graphs[generator.Pick(3)];
        outcome = robot.Graph();
        break;
      case 1:
        outcome = robot.Tick(generator.Pick(4) == 0 ? levels::Lateness::kLate
                                                    : levels::Lateness::kTimely);
        break;
      case 2:
        outcome =
            OnProgramResult(generator.Pick(30), generator.Pick(2) == 0, robot.now, robot.state);
        break;
      case 3:
        robot.state.actuation = static_cast<Actuation>(generator.Pick(4));
        outcome = OnActuation(robot.now, robot.state);
        break;
      case 4:
        outcome = Expire(robot.now, robot.state);
        break;
      case 5:
        robot.state.evidence.blind_because.assign(generator.Pick(2), "x");
        break;
      default:
        outcome = robot.Message(generator.Pick(2) == 0 ? "/a" : "/b");
    }
    for (std::string& line : Lines(outcome, robot.state)) log.push_back(std::move(line));
    log.push_back(absl::StrCat(outcome.fired, " ", outcome.faults));
    // The level sinks only as the levels allow: from B or C, a step at a time, each with an effect.
    size_t decisions = 0;
    for (const Effect& effect : outcome.effects) {
      const auto* change = std::get_if<TransitionEffect>(&effect);
      if (change == nullptr || !change->transition.decided()) continue;
      ++decisions;
      if (change->transition.lowers()) {
        EXPECT_EQ(change->transition.from - change->transition.to, 1);
        EXPECT_NE(change->transition.from, 3);
        EXPECT_TRUE(robot.state.evidence.blind_because.empty());
      }
    }
    EXPECT_TRUE(decisions > 0 || robot.state.level.level() == before);
    // The same policy again: only what is remembered of topics and refusals is lost.
    if (forget) {
      EXPECT_THAT(robot.state.SwapProgram(program), IsOk());
    }
  }
  return absl::StrJoin(log, "\n");
}

TEST(RandomTest, TheSameInputGivesTheSameOutput) {
  size_t alerts = 0;
  for (uint32_t seed = 1; seed <= 150; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    const std::string first = Play(seed, false);
    EXPECT_EQ(first, Play(seed, false));
    alerts += first.find("alert") != std::string::npos;
    if (HasFailure()) return;
  }
  EXPECT_GT(alerts, 75u) << "the programs do something";
}

TEST(RandomTest, WhatIsRememberedOfTopicsChangesNothing) {
  for (uint32_t seed = 1; seed <= 50; ++seed) {
    SCOPED_TRACE(testing::Message() << "seed " << seed);
    // Alerts about faults and counts of refusals begin anew with a policy; the rest is the same.
    const auto normal = [](const std::string& log) {
      std::vector<std::string> out;
      for (const absl::string_view line : absl::StrSplit(log, '\n')) {
        if (absl::StrContains(line, " high: fault in rule ")) continue;
        out.emplace_back(absl::StartsWith(line, "refused ") ? line.substr(0, line.rfind(" x"))
                                                            : line);
      }
      return out;
    };
    EXPECT_EQ(normal(Play(seed, false)), normal(Play(seed, true)));
    if (HasFailure()) return;
  }
}

TEST(RandomTest, IllTypedProgramsAreRefusedOrRun) {
  std::mt19937 random(11);
  const auto pick = [&](size_t n) { return random() % n; };
  for (int round = 0; round < 3'000; ++round) {
    Exprs pool = {I(0), F(1), B(true), S("/a"), V(9), Name(Predefined::kLevel)};
    for (int i = 0; i < 12; ++i) {
      TypedExpr expr;
      const TypedExpr a = pool[pick(pool.size())];
      const TypedExpr b = pool[pick(pool.size())];
      switch (pick(3)) {
        case 0:
          expr = Op(a, static_cast<BinaryOp>(pick(16)), b);
          break;
        case 1:
          expr = Op(static_cast<UnaryOp>(pick(4)), a);
          break;
        default:
          expr = Call(static_cast<Builtin>(pick(lang::kBuiltinCount)),
                      pick(2) == 0 ? Exprs{a} : Exprs{a, b});
      }
      pool.push_back(std::move(expr));
    }
    TestRules rules;
    rules.Msg("r", pool.back(), {{Alert(pool[pick(pool.size())])}});
    const auto program = CompiledPolicy::Create(rules.rules);
    if (!program.ok()) continue;
    TestRobot robot(*program);
    robot.Message("/a");
  }
}

}  // namespace
}  // namespace rips::engine
