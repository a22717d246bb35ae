// Payloads and plugins: what must be asked, and what becomes of rules that are not told.
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr Verdict kYes = Verdict::kYes;
constexpr Verdict kNo = Verdict::kNo;
constexpr Verdict kUnscanned = Verdict::kUnscanned;

TypedExpr OnTopic(const std::string& topic) { return Call(Builtin::kTopicIn, Texts({topic})); }

struct Told {
  Outcome outcome;
  std::vector<std::string> lines;
};

Told Judge(const TestRules& rules, std::vector<Verdict> verdicts,
           CompiledPolicyOptions options = {}) {
  TestRobot robot(rules.Build(options));
  Told told;
  told.outcome = robot.Judge(MessageEvent{.topic = "/a", .inspections = verdicts});
  told.lines = Lines(told.outcome, robot.state);
  return told;
}

bool Fires(TypedExpr condition, std::vector<Verdict> verdicts) {
  TestRules rules;
  rules.Inspections(2).Msg("r", std::move(condition), {{Alert("fired")}});
  return Judge(rules, std::move(verdicts)).outcome.fired == 1;
}

TEST(InspectionTest, AnswersDecide) {
  EXPECT_TRUE(Fires(Inspect(0), {kYes, kNo}));
  EXPECT_FALSE(Fires(Inspect(1), {kYes, kNo}));
  EXPECT_TRUE(Fires(Not(Inspect(1)), {kYes, kNo}));
}

// `?` is neither true nor false: the rule fires exactly if its value depends on it.
TEST(InspectionTest, WhatWasNotToldFires) {
  EXPECT_TRUE(Fires(Inspect(0), {kUnscanned, kNo}));
  EXPECT_TRUE(Fires(Not(Inspect(0)), {kUnscanned, kNo}));
  EXPECT_TRUE(Fires(Inspect(0), {})) << "nobody was asked";
  EXPECT_FALSE(Fires(And(B(false), Inspect(0)), {kUnscanned}));
  EXPECT_FALSE(Fires(And(Inspect(0), OnTopic("/other")), {kUnscanned}));
  EXPECT_TRUE(Fires(Or(Inspect(0), OnTopic("/a")), {kUnscanned}));
  EXPECT_TRUE(Fires(And(Inspect(0), OnTopic("/a")), {kUnscanned}));
  EXPECT_FALSE(Fires(Not(Or(Inspect(0), OnTopic("/a"))), {kUnscanned}));
  EXPECT_TRUE(Fires(Op(Inspect(0), BinaryOp::kEq, B(false)), {kUnscanned}));
  EXPECT_FALSE(Fires(And(Inspect(0), Inspect(1)), {kUnscanned, kNo}));
  EXPECT_TRUE(Fires(And(Inspect(0), Inspect(1)), {kUnscanned, kYes}));
}

TEST(InspectionTest, AFaultIsStrongerThanNotKnowing) {
  for (const TypedExpr& condition :
       {And(Inspect(0), Faulty()), Or(Inspect(0), Faulty()), And(Faulty(), Inspect(0))}) {
    TestRules rules;
    rules.Inspections(1).Msg("r", condition, {{Alert("fired")}});
    const Told told = Judge(rules, {kUnscanned});
    EXPECT_EQ(told.outcome.fired, 0u);
    EXPECT_EQ(told.outcome.faults, 1u);
  }
}

TEST(InspectionTest, TheBundleMayHaveItOtherwise) {
  TestRules rules;
  rules.Inspections(1).Msg("r", Inspect(0), {{Alert("fired")}});

  const Told match = Judge(rules, {kUnscanned});
  EXPECT_THAT(match.lines, ElementsAre("alert r medium: fired"));
  EXPECT_EQ(match.outcome.unscanned, 1u);
  const Told alert = Judge(rules, {kUnscanned}, {.on_inspection_error = OnInspectionError::kAlert});
  EXPECT_THAT(alert.lines, ElementsAre(HasSubstr("the message could not be inspected; it did not "
                                                 "fire")));
  const Told ignore =
      Judge(rules, {kUnscanned}, {.on_inspection_error = OnInspectionError::kIgnore});
  EXPECT_THAT(ignore.lines, IsEmpty());
  EXPECT_EQ(ignore.outcome.unscanned, 1u);
}

TEST(InspectionTest, ObserversSeeWhatFiredWithoutBeingTold) {
  class Seen final : public RuleObserver {
   public:
    void OnRule(uint32_t, RuleResult came, absl::string_view) override { all.push_back(came); }
    std::vector<RuleResult> all;
  };
  using RuleResult = RuleObserver::RuleResult;
  TestRules rules;
  rules.Inspections(2);
  rules.Msg("told", Inspect(1), {{Alert("told")}}).Msg("not told", Inspect(0), {{Alert("fired")}});
  const std::vector<Verdict> verdicts = {kUnscanned, kYes};
  const auto came = [&](OnInspectionError then) {
    TestRobot robot(rules.Build({.on_inspection_error = then}));
    Seen seen;
    robot.state.observer = &seen;
    robot.Judge(MessageEvent{.topic = "/a", .inspections = verdicts});
    return seen.all;
  };

  EXPECT_THAT(came(OnInspectionError::kMatch),
              ElementsAre(RuleResult::kFired, RuleResult::kFiredUnscanned));
  EXPECT_THAT(came(OnInspectionError::kAlert),
              ElementsAre(RuleResult::kFired, RuleResult::kUnscanned));
  EXPECT_THAT(came(OnInspectionError::kIgnore),
              ElementsAre(RuleResult::kFired, RuleResult::kUnscanned));
}

TEST(InspectionTest, AnActionWhoseArgumentWasNotToldFails) {
  TestRules rules;
  const uint32_t flag = rules.Var("b", ValueType::kBool, false);
  rules.Inspections(1).Msg("r", B(true),
                           {{Set(flag, Inspect(0)) >> kElse, Alert("it was not set")}});
  EXPECT_THAT(Judge(rules, {kUnscanned}).lines,
              ElementsAre(HasSubstr("an argument needs an inspection that was not made"),
                          "alert r medium: it was not set"));
  EXPECT_THAT(Judge(rules, {kYes}).lines, IsEmpty());
}

TEST(InspectionTest, AParkedChainKeepsWhatItsMessageWasTold) {
  TestRules rules;
  const uint32_t flag = rules.Var("b", ValueType::kBool, false);
  rules.Inspections(1).Msg("r", B(true), {{Exec({"p"}) >> kThen, Set(flag, Inspect(0))}});
  TestRobot robot(rules);
  {
    const std::vector<Verdict> verdicts = {kYes};
    robot.Judge(MessageEvent{.topic = "/a", .inspections = verdicts});
  }
  OnProgramResult(1, true, robot.now, robot.state);
  EXPECT_EQ(std::get<bool>(robot.state.Variables().at("b")), true);
}

class NeededTest : public testing::Test {
 protected:
  std::vector<uint32_t> On(const std::string& topic, const std::string& sender = "/n",
                           uint32_t size = 10) {
    Event event;
    event.what = MessageEvent{.topic = topic, .sender = sender, .size_bytes = size};
    return NeededInspections(event, robot_->now, robot_->state);
  }
  void Start() { robot_.emplace(rules_); }

  TestRules rules_;
  std::optional<TestRobot> robot_;
};

TEST_F(NeededTest, AsksOnlyForRulesThatMayApplyToTheMessage) {
  rules_.Inspections(6);
  const std::vector<TypedChain> chains = {{Alert("x")}};
  rules_.Msg("0", And(OnTopic("/a"), Inspect(0)), chains);
  rules_.Msg("1", And(OnTopic("/b"), Inspect(1)), chains);
  rules_.Msg("2", And(Call(Builtin::kSenderIn, Texts({"camera"})), Inspect(2)), chains);
  rules_.Msg("3", And(Call(Builtin::kPayloadSize, {I(100), I(200)}), Inspect(3)), chains);
  rules_.Msg("4", And(OnTopic("/c"), Or(Inspect(0), And(B(true), Inspect(4)))), chains);
  Start();

  EXPECT_THAT(On("/a"), ElementsAre(0));
  EXPECT_THAT(On("/b"), ElementsAre(1));
  EXPECT_THAT(On("/c"), ElementsAre(0, 4));
  EXPECT_THAT(On("/d"), IsEmpty());
  EXPECT_THAT(On("/d", "/left/camera"), ElementsAre(2));
  EXPECT_THAT(On("/d", "", 100), ElementsAre(3));
}

// Between the question and the judgement the graph, variables and the level may change.
TEST_F(NeededTest, CountsOnNothingThatMayChange) {
  rules_.Inspections(5);
  const uint32_t on = rules_.Var("on", ValueType::kBool, false);
  const std::vector<TypedChain> chains = {{Alert("x")}};
  rules_.Msg("0", And(V(on), Inspect(0)), chains);
  rules_.Msg("1", And(Op(Name(Predefined::kCurrLevel), BinaryOp::kEq, L(3)), Inspect(1)), chains);
  rules_.Msg("2", And(Call(Builtin::kPublishers, Texts({"/n"})), Inspect(2)), chains);
  rules_.Msg("3", And(Call(Builtin::kMsgCount, {I(1'000), I(9), I(10)}), Inspect(3)), chains);
  rules_.Msg("4", And(Call(Builtin::kNodeCount, {I(9), I(10)}), Inspect(4)), chains);
  Start();
  EXPECT_THAT(On("/a"), ElementsAre(0, 1, 2, 3, 4));
}

TEST_F(NeededTest, ArgumentsOfActionsAreAskedFor) {
  rules_.Inspections(3);
  const uint32_t flag = rules_.Var("b", ValueType::kBool, false);
  rules_.Msg("0", OnTopic("/a"), {{Set(flag, Inspect(1))}});
  rules_.Msg("1", And(OnTopic("/b"), Inspect(0)), {{Set(flag, Inspect(2))}});
  Start();
  EXPECT_THAT(On("/a"), ElementsAre(1));
  EXPECT_THAT(On("/b"), ElementsAre(0, 2));
}

TEST_F(NeededTest, OtherEventsNeedNothing) {
  rules_.Inspections(1).Msg("0", Inspect(0), {{Alert("x")}});
  Start();
  Event event;
  event.what = GraphEvent{};
  EXPECT_THAT(NeededInspections(event, robot_->now, robot_->state), IsEmpty());
  EXPECT_THAT(On("/a"), ElementsAre(0));
  robot_->state.Halt();
  EXPECT_THAT(On("/a"), IsEmpty());
}

}  // namespace
}  // namespace rips::engine
