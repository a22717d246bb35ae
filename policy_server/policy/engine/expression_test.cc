#include <limits>
#include <optional>
#include <string>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/eval/evaluation.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

constexpr int64_t kMin = std::numeric_limits<int64_t>::min();
constexpr int64_t kMax = std::numeric_limits<int64_t>::max();

// The text of string(expr) in an alert of a rule on a tick; nullopt if it faults.
std::optional<std::string> Show(TypedExpr expr, levels::LevelIndex level = 0) {
  TestRules rules;
  rules.Tick("r", B(true), {{Alert(Text(std::move(expr)))}});
  TestRobot robot(rules, level);
  robot.Advance(5);
  const Outcome outcome = robot.Tick();
  EXPECT_EQ(outcome.effects.size(), 1u);
  if (outcome.faults > 0) return std::nullopt;
  return std::get<AlertEffect>(outcome.effects.at(0)).text;
}

TEST(ExpressionTest, ComputesIntegers) {
  const struct {
    int64_t left;
    BinaryOp op;
    int64_t right;
    std::optional<std::string> want;
  } kCases[] = {
      {2, BinaryOp::kAdd, 3, "5"},
      {kMax, BinaryOp::kAdd, 1, "-9223372036854775808"},
      {kMin, BinaryOp::kSub, 1, "9223372036854775807"},
      {kMax, BinaryOp::kMul, 2, "-2"},
      {kMin, BinaryOp::kMul, -1, "-9223372036854775808"},
      {7, BinaryOp::kDiv, 2, "3"},
      {-7, BinaryOp::kDiv, 2, "-3"},
      {7, BinaryOp::kDiv, -2, "-3"},
      {kMin, BinaryOp::kDiv, -1, "-9223372036854775808"},
      {5, BinaryOp::kDiv, 0, std::nullopt},
      {7, BinaryOp::kMod, 3, "1"},
      {-7, BinaryOp::kMod, 3, "-1"},
      {7, BinaryOp::kMod, -3, "1"},
      {kMin, BinaryOp::kMod, -1, "0"},
      {5, BinaryOp::kMod, 0, std::nullopt},
      {6, BinaryOp::kBitAnd, 3, "2"},
      {6, BinaryOp::kBitOr, 3, "7"},
      {6, BinaryOp::kBitXor, 3, "5"},
      {1, BinaryOp::kEq, 1, "true"},
      {1, BinaryOp::kNe, 1, "false"},
      {-1, BinaryOp::kLt, 1, "true"},
      {1, BinaryOp::kLe, 1, "true"},
      {1, BinaryOp::kGt, 1, "false"},
      {1, BinaryOp::kGe, 1, "true"},
  };
  for (const auto& c : kCases) {
    EXPECT_EQ(Show(Op(I(c.left), c.op, I(c.right))), c.want)
        << c.left << " op " << static_cast<int>(c.op) << " " << c.right;
  }
  EXPECT_EQ(Show(Op(UnaryOp::kMinus, I(kMin))), "-9223372036854775808");
  EXPECT_EQ(Show(Op(UnaryOp::kPlus, I(4))), "4");
  EXPECT_EQ(Show(Op(UnaryOp::kComplement, I(0))), "-1");
}

TEST(ExpressionTest, ComputesFloats) {
  EXPECT_EQ(Show(Op(F(1.5), BinaryOp::kAdd, F(2))), "3.5");
  EXPECT_EQ(Show(Op(F(1.5), BinaryOp::kSub, F(2))), "-0.5");
  EXPECT_EQ(Show(Op(F(1.5), BinaryOp::kMul, F(2))), "3");
  EXPECT_EQ(Show(Op(F(1), BinaryOp::kDiv, F(0))), "+Inf");
  EXPECT_EQ(Show(Op(F(-1), BinaryOp::kDiv, F(0))), "-Inf");
  EXPECT_EQ(Show(Op(F(0), BinaryOp::kDiv, F(0))), "NaN");
  EXPECT_EQ(Show(Op(F(1), BinaryOp::kLt, F(2))), "true");
  EXPECT_EQ(Show(Op(UnaryOp::kMinus, F(1.5))), "-1.5");
}

TEST(ExpressionTest, ComparesBoolsAndStrings) {
  EXPECT_EQ(Show(Op(B(false), BinaryOp::kLt, B(true))), "true");
  EXPECT_EQ(Show(Op(B(true), BinaryOp::kEq, B(true))), "true");
  EXPECT_EQ(Show(Op(S("a"), BinaryOp::kLt, S("b"))), "true");
  EXPECT_EQ(Show(Op(S("Z"), BinaryOp::kLt, S("a"))), "true");
  EXPECT_EQ(Show(Op(S("z"), BinaryOp::kLt, S("\xC3\xA4"))), "true") << "bytes are unsigned";
  EXPECT_EQ(Show(Op(S(std::string("a\0b", 3)), BinaryOp::kEq, S("a"))), "false");
  EXPECT_EQ(Show(Concat(Concat(S("a"), S("b")), S("c"))), "abc");
}

// {true, false, fault} x {true, false, fault}, as in the header.
TEST(ExpressionTest, ShortCircuitsBeforeItFaults) {
  const auto operand = [](int i) { return i == 0 ? B(true) : i == 1 ? B(false) : Faulty(); };
  const std::optional<std::string> t = "true";
  const std::optional<std::string> f = "false";
  const std::optional<std::string> x = std::nullopt;
  const std::optional<std::string> want_and[3][3] = {{t, f, x}, {f, f, f}, {x, x, x}};
  const std::optional<std::string> want_or[3][3] = {{t, t, t}, {t, f, x}, {x, x, x}};
  for (int a = 0; a < 3; ++a) {
    for (int b = 0; b < 3; ++b) {
      EXPECT_EQ(Show(And(operand(a), operand(b))), want_and[a][b]) << a << " && " << b;
      EXPECT_EQ(Show(Or(operand(a), operand(b))), want_or[a][b]) << a << " || " << b;
    }
  }
  EXPECT_EQ(Show(Not(B(true))), f);
  EXPECT_EQ(Show(Not(B(false))), t);
  EXPECT_EQ(Show(Not(Faulty())), x);
}

TEST(ExpressionTest, EvaluatesRunsFromTheLeft) {
  // (10 - 3) - 2, and not 10 - (3 - 2).
  EXPECT_EQ(Show(Op(Op(I(10), BinaryOp::kSub, I(3)), BinaryOp::kSub, I(2))), "5");
  EXPECT_EQ(Show(Op(I(10), BinaryOp::kSub, Op(I(3), BinaryOp::kSub, I(2)))), "9");
  // (false && fault) || true
  EXPECT_EQ(Show(Or(And(B(false), Faulty()), B(true))), "true");
  EXPECT_EQ(Show(And(Or(B(true), Faulty()), B(false))), "false");
}

TEST(ExpressionTest, KnowsThePredefinedNames) {
  EXPECT_EQ(Show(Name(Predefined::kCurrLevel), 2), "2");
  EXPECT_EQ(Show(Name(Predefined::kLevel), 2), "C");
  EXPECT_EQ(Show(Name(Predefined::kCurrRule)), "r");
  EXPECT_EQ(Show(Name(Predefined::kTime)), "1700000000000000005");
  EXPECT_EQ(Show(Name(Predefined::kUptime)), "5");
}

TEST(ExpressionTest, NamesLevels) {
  EXPECT_EQ(Show(Call(Builtin::kLevelName, {L(1)})), "B");
  EXPECT_EQ(Show(Call(Builtin::kLevelName, {I(3)})), "D");
  for (const int64_t none : {int64_t{-1}, int64_t{4}, kMin, kMax}) {
    EXPECT_EQ(Show(Call(Builtin::kLevelName, {I(none)})), "");
  }
}

TEST(ExpressionTest, WritesValuesAsText) {
  EXPECT_EQ(Show(Text(S("as is"))), "as is");
  EXPECT_EQ(Show(B(true)), "true");
  EXPECT_EQ(Show(F(1.0)), "1");
  EXPECT_EQ(Show(F(1e21)), "1e+21");
  EXPECT_EQ(Show(I(kMin)), "-9223372036854775808");
  EXPECT_EQ(Show(L(2)), "2");
}

// The checker lets none of these through; the program is refused, not the server broken.
TEST(ExpressionTest, IllTypedRulesAreRefused) {
  const TypedExpr kWrong[] = {
      Op(I(1), BinaryOp::kAdd, F(1)),
      Op(B(true), BinaryOp::kAdd, B(true)),
      Op(F(1), BinaryOp::kMod, F(1)),
      Op(S("a"), BinaryOp::kSub, S("a")),
      And(I(1), B(true)),
      And(B(true), I(1)),
      Op(UnaryOp::kMinus, S("a")),
      Op(UnaryOp::kComplement, F(1)),
      V(7),
      Call(Builtin::kNodeCount, Texts({"a", "b"})),
      Call(Builtin::kService, Texts({"a"})),
      Call(Builtin::kNodes, {I(1)}),
      Call(Builtin::kServices, {}),
      Call(Builtin::kPayload, {}),
      Call(Builtin::kMsgCount, {Op(I(1), BinaryOp::kAdd, I(1)), I(1), I(2)}),
      Call(Builtin::kMsgCount, {I(0), I(1), I(2)}),
      Call(Builtin::kEval, {}),
  };
  for (const TypedExpr& wrong : kWrong) {
    TestRules rules;
    rules.Msg("r", B(true), {{Alert(Text(wrong))}});
    EXPECT_FALSE(CompiledPolicy::Create(rules.rules).ok());
  }
  TestRules rules;
  rules.Msg("r", I(1), {{Alert("x")}});
  EXPECT_FALSE(CompiledPolicy::Create(rules.rules).ok()) << "a condition that is no bool";
}

TEST(ExpressionTest, CutsLongStringsAndSaysSoOnceARule) {
  TestRules rules;
  const uint32_t s = rules.Var("s", ValueType::kString, std::string("x"));
  rules.Tick("grow", B(true), {{Set(s, Concat(V(s), V(s)))}});
  TestRobot robot(rules);

  uint32_t cuts = 0;
  for (int i = 0; i < 20; ++i) {
    const Outcome outcome = robot.Tick();
    for (const std::string& rule : outcome.cut_strings) {
      EXPECT_EQ(rule, "grow");
      ++cuts;
    }
    EXPECT_EQ(outcome.faults, 0u);
  }

  EXPECT_EQ(std::get<std::string>(robot.state.Variables().at("s")).size(), 4'096u);
  EXPECT_EQ(cuts, 1u);
}

TEST(ExpressionTest, KeepsExactlyTheLongestString) {
  TestRules rules;
  const uint32_t s = rules.Var("s", ValueType::kString, std::string());
  rules.Tick("r", B(true), {{Set(s, Concat(S(std::string(4'095, 'x')), S("ä")))}});
  TestRobot robot(rules);

  EXPECT_TRUE(robot.Tick().cut_strings.empty());
  EXPECT_EQ(std::get<std::string>(robot.state.Variables().at("s")).size(), 4'097u);
}

TEST(ExpressionTest, EvaluatesRunsAsLongAsTheCheckerAllows) {
  TypedExpr sum = I(0);
  TypedExpr any = B(false);
  constexpr int kTerms = 4'000;
  for (int i = 0; i < kTerms; ++i) {
    sum = Op(std::move(sum), BinaryOp::kAdd, I(1));
    any = Or(std::move(any), Op(Name(Predefined::kCurrLevel), BinaryOp::kGt, I(5)));
  }

  EXPECT_EQ(Show(std::move(sum)), "4000");
  EXPECT_EQ(Show(std::move(any)), "false");
}

TEST(ExpressionTest, TimeNeverGoesBack) {
  TestRules rules;
  const uint32_t t = rules.IntVar("t", 0);
  rules.Tick("r", B(true), {{Set(t, Name(Predefined::kTime))}});
  TestRobot robot(rules);
  const auto judge = [&](int64_t time_ns) {
    Event event{.time_unix_ns = time_ns};
    event.what.emplace<ExternalEvent>(TickEvent{});
    Evaluate(event, robot.now, robot.state);
    return robot.Int("t");
  };

  EXPECT_EQ(judge(-5), -5);
  EXPECT_EQ(judge(100), 100);
  EXPECT_EQ(judge(50), 100);
  EXPECT_EQ(judge(101), 101);
  EXPECT_EQ(judge(kMax), kMax);
  EXPECT_EQ(judge(kMin), kMax);
}

}  // namespace
}  // namespace rips::engine
