#include "policy_server/policy/engine/foresight.h"

#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

TEST(WouldRaiseTest, NamesRulesThatWouldRaiseAgainOnTheGraphOrATick) {
  TestRules rules;
  const auto stranger = Not(Call(Builtin::kNodesInclude, Texts({"talker"})));
  rules.Graph("alert only", stranger, {{Alert("x")}});
  rules.Graph("raise later", stranger, {{Alert("x") >> kThen, Trigger(3)}});
  rules.Graph("second chain", stranger, {{Alert("x")}, {Trigger(2)}});
  rules.Graph("at A", And(stranger, Op(Name(Predefined::kCurrLevel), BinaryOp::kEq, L(0))),
              {{Trigger(1)}});
  rules.Graph("lower", stranger, {{Trigger(0)}});
  rules.Graph("quiet", Not(stranger), {{Trigger(3)}});
  rules.Graph("faulty", Faulty(), {{Trigger(3)}});
  rules.Tick("on a tick", Call(Builtin::kFindingStands, Texts({"any"})), {{Trigger(3)}});
  rules.Tick("not known", Not(Call(Builtin::kFindingStands, Texts({"impostor"}))), {{Trigger(3)}});
  rules.Tick("an event", Call(Builtin::kSignal, Texts({"SIGUSR1"})), {{Trigger(3)}});
  TestRobot robot(rules, 3);
  robot.state.graph = TestGraph().Node("/talker").Node("/intruder").Build();
  robot.state.findings.Add("non_ros_reader");
  const auto variables = robot.state.Variables();

  EXPECT_THAT(WouldRaise(0, robot.now, robot.state),
              ElementsAre("raise later", "second chain", "at A", "on a tick"));
  EXPECT_THAT(WouldRaise(1, robot.now, robot.state),
              ElementsAre("raise later", "second chain", "on a tick"));
  EXPECT_THAT(WouldRaise(2, robot.now, robot.state), ElementsAre("raise later", "on a tick"));
  EXPECT_THAT(WouldRaise(3, robot.now, robot.state), IsEmpty());
  EXPECT_THAT(WouldRaise(-1, robot.now, robot.state), IsEmpty());
  EXPECT_THAT(WouldRaise(4, robot.now, robot.state), IsEmpty());
  EXPECT_EQ(robot.state.level.level(), 3);
  EXPECT_EQ(robot.state.level.decision_id(), (DecisionId{1, 1}));
  EXPECT_EQ(robot.state.Variables(), variables);
}

TEST(LoweringRulesTest, SayWhatMayLeaveTheLevelAndWhetherItWouldNow) {
  TestRules rules;
  const auto stranger = Call(Builtin::kHasNodes, Texts({"/intruder"}));
  rules.Graph("no stranger", Not(stranger), {{Alert("x") >> kThen, Trigger(1)}});
  rules.Graph("two levels down", Not(stranger), {{Trigger(0)}});
  rules.Graph("up", Not(stranger), {{Trigger(3)}});
  rules.Graph("faulty", Faulty(), {{Trigger(1)}});
  rules.Tick("nothing stands", Not(Call(Builtin::kFindingStands, Texts({"any"}))), {{Trigger(1)}});
  rules.Msg("on a message", Call(Builtin::kTopicIn, Texts({"/calm"})), {{Trigger(1)}});
  TestRobot robot(rules, 2);
  robot.state.graph = TestGraph().Node("/talker").Build();
  robot.state.findings.Add("non_ros_reader");
  const auto variables = robot.state.Variables();
  const auto found = [&] {
    std::vector<std::string> names;
    for (const LoweringRule& rule : LoweringRules(robot.now, robot.state)) {
      names.push_back(absl::StrCat(rule.name, !rule.holds   ? ": on messages"
                                              : *rule.holds ? ": holds"
                                                            : ": does not hold"));
    }
    return names;
  };
  EXPECT_THAT(found(), ElementsAre("no stranger: holds", "faulty: does not hold",
                                   "nothing stands: does not hold", "on a message: on messages"));
  robot.state.graph = TestGraph().Node("/talker").Node("/intruder").Build();
  EXPECT_EQ(found()[0], "no stranger: does not hold");
  EXPECT_EQ(robot.state.level.level(), 2);
  EXPECT_EQ(robot.state.level.decision_id(), (DecisionId{1, 1}));
  EXPECT_EQ(robot.state.Variables(), variables);
}

TEST(LoweringRulesTest, AreNoneAtALevelThatIsNotSoft) {
  TestRules rules;
  rules.Graph("lower", B(true), {{Trigger(2)}});
  const TestRobot top(rules, 3), bottom(rules, 0);
  EXPECT_THAT(LoweringRules(top.now, top.state), IsEmpty());
  EXPECT_THAT(LoweringRules(bottom.now, bottom.state), IsEmpty());
}

TEST(LoweringRulesTest, AreBounded) {
  TestRules rules;
  for (size_t i = 0; i < 2 * kLoweringRulesMax; ++i) {
    rules.Graph(absl::StrCat("graph", i), B(true), {{Trigger(1)}});
    rules.Msg(absl::StrCat("message", i), B(true), {{Trigger(1)}});
  }
  const TestRobot robot(rules, 2);
  EXPECT_EQ(LoweringRules(robot.now, robot.state).size(), kLoweringRulesMax);
}

}  // namespace
}  // namespace rips::engine
