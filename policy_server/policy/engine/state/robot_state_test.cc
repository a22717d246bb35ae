#include "policy_server/policy/engine/state/robot_state.h"

#include <string>
#include <utility>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Pair;

TEST(RobotStateTest, VariablesStartAsDeclaredAndAreRestoredByNameAndType) {
  TestRules rules;
  rules.IntVar("n", 1);
  rules.Var("f", ValueType::kFloat, 1.5);
  rules.Var("s", ValueType::kString, std::string("s"));
  TestRobot robot(rules);
  EXPECT_THAT(robot.state.Variables(),
              ElementsAre(Pair("f", lang::Value(1.5)), Pair("n", lang::Value(int64_t{1})),
                          Pair("s", lang::Value(std::string("s")))));

  robot.state.RestoreVariables(
      {{"n", int64_t{9}}, {"f", int64_t{2}}, {"s", std::string(5'000, 'x')}, {"gone", true}});

  EXPECT_THAT(robot.state.Variables(),
              ElementsAre(Pair("f", lang::Value(1.5)), Pair("n", lang::Value(int64_t{9})),
                          Pair("s", lang::Value(std::string(4'096, 'x')))));
}

TEST(RobotStateTest, RestoresOnlyLevelsIntoAVariableForTrigger) {
  TestRules rules;
  const uint32_t to = rules.IntVar("to", 1);
  rules.Tick("r", B(false), {{Trigger(V(to))}});
  TestRobot robot(rules);

  for (const int64_t bad : {int64_t{-1}, int64_t{4}}) {
    robot.state.RestoreVariables({{"to", bad}});
    EXPECT_EQ(robot.Int("to"), 1);
  }
  robot.state.RestoreVariables({{"to", int64_t{3}}});
  EXPECT_EQ(robot.Int("to"), 3);
}

TEST(RobotStateTest, SwapKeepsVariablesByNameAndTypeAndTheLevelByName) {
  TestRules before;
  before.IntVar("kept", 1);
  before.IntVar("retyped", 2);
  before.IntVar("dropped", 3);
  TestRobot robot(before, 2);
  robot.state.RestoreVariables({{"kept", int64_t{10}}, {"retyped", int64_t{20}}});

  TestRules after;
  after.rules.levels = levels::LevelTable({{"C"}, {"E"}});
  after.Var("retyped", ValueType::kString, std::string("new"));
  after.IntVar("fresh", 5);
  after.IntVar("kept", 6);
  EXPECT_THAT(robot.state.SwapProgram(after.Build()), IsOk());

  EXPECT_THAT(
      robot.state.Variables(),
      ElementsAre(Pair("fresh", lang::Value(int64_t{5})), Pair("kept", lang::Value(int64_t{10})),
                  Pair("retyped", lang::Value(std::string("new")))));
  EXPECT_EQ(robot.state.level.level(), 0);
  EXPECT_EQ(robot.state.level.decision_id(), (DecisionId{1, 1}));
}

TEST(RobotStateTest, SwapIsRefusedWithoutTheCurrentLevel) {
  TestRules before;
  before.IntVar("x", 1);
  TestRobot robot(before, 2);
  const std::shared_ptr<const CompiledPolicy> program = robot.state.program();
  TestRules after;
  after.rules.levels = levels::LevelTable({{"A"}, {"B"}});

  EXPECT_THAT(robot.state.SwapProgram(after.Build()),
              StatusIs(absl::StatusCode::kFailedPrecondition, HasSubstr("`C`")));

  EXPECT_EQ(robot.state.program(), program);
  EXPECT_EQ(robot.Int("x"), 1);
  EXPECT_EQ(robot.state.level.table().size(), 4);
}

TEST(RobotStateTest, ALevelInAVariableFollowsItsName) {
  TestRules before;
  const uint32_t to = before.IntVar("to", 3);
  const uint32_t gone = before.IntVar("gone", 1);
  before.Tick("r", B(false), {{Trigger(V(to))}, {Trigger(V(gone))}});
  TestRobot robot(before);

  TestRules after;
  after.rules.levels = levels::LevelTable({{"A"}, {"D"}, {"C"}});
  after.IntVar("gone", 2);
  after.IntVar("to", 0);
  after.Tick("r", B(false), {{Trigger(V(0))}, {Trigger(V(1))}});
  EXPECT_THAT(robot.state.SwapProgram(after.Build()), IsOk());

  EXPECT_EQ(robot.Int("to"), 1) << "still D";
  EXPECT_EQ(robot.Int("gone"), 2) << "B is gone; as declared";
}

// exec, then sets and an alert that reads both a kept and a vanished variable, then a trigger of D.
TestRules Parks() {
  TestRules rules;
  const uint32_t gone = rules.IntVar("gone", 7);
  const uint32_t kept = rules.IntVar("kept", 1);
  rules.Tick("old", B(true),
             {{Exec({"p"}) >> kThen, Set(gone, I(70)) >> kThen, Set(kept, I(11)) >> kThen,
               Alert(Concat(Concat(Text(V(gone)), S(" ")),
                            Concat(Text(V(kept)), Text(Name(Predefined::kCurrLevel))))) >>
                   kThen,
               Trigger(3)}});
  return rules;
}

TEST(RobotStateTest, ParkedChainsFinishUnderTheOldRules) {
  TestRobot robot(Parks());
  robot.Tick();
  robot.state.RestoreVariables({{"gone", int64_t{8}}});

  TestRules after;
  after.rules.levels = levels::LevelTable({{"X"}, {"A"}, {"D"}, {"Z"}});
  after.IntVar("kept", 0);
  EXPECT_THAT(robot.state.SwapProgram(after.Build()), IsOk());
  const Outcome outcome = OnProgramResult(1, true, robot.now, robot.state);

  // The vanished variable keeps its last value, levels are meant by name.
  EXPECT_THAT(Lines(outcome, robot.state),
              ElementsAre("alert old medium: 8 110", "level old A->D 1.2"));
  EXPECT_TRUE(outcome.variables_changed);
  EXPECT_THAT(robot.state.Variables(), ElementsAre(Pair("kept", lang::Value(int64_t{11}))));
  EXPECT_EQ(robot.state.level.level(), 2);
}

TEST(RobotStateTest, AnOldTriggerOfAVanishedLevelFails) {
  TestRobot robot(Parks());
  robot.Tick();
  TestRules after;
  after.rules.levels = levels::LevelTable({{"A"}, {"X"}, {"Y"}, {"Z"}});
  EXPECT_THAT(robot.state.SwapProgram(after.Build()), IsOk());

  const Outcome outcome = OnProgramResult(1, true, robot.now, robot.state);

  EXPECT_EQ(outcome.faults, 1u);
  EXPECT_EQ(robot.state.level.level(), 0);
}

TEST(RobotStateTest, AWaitForALevelFollowsItsName) {
  TestRules rules;
  rules.Tick("r", B(true), {{Trigger(1) >> kThen, Alert("yes")}});
  TestRobot robot(rules);
  robot.state.actuation = Actuation::kPending;
  robot.Tick();
  TestRules after;
  after.rules.levels = levels::LevelTable({{"A"}, {"X"}, {"B"}});
  EXPECT_THAT(robot.state.SwapProgram(after.Build()), IsOk());

  EXPECT_THAT(Lines(robot.Verified(), robot.state), ElementsAre("alert r medium: yes"));
}

TEST(RobotStateTest, UptimeGoesOnAfterASwap) {
  const auto rules = [](const std::string& name) {
    TestRules out;
    out.Tick(name, B(true), {{Alert(Text(Name(Predefined::kUptime)))}});
    return out;
  };
  TestRobot robot(rules("before"));
  robot.Advance(5);
  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("alert before medium: 5"));

  EXPECT_THAT(robot.state.SwapProgram(rules("after").Build()), IsOk());

  robot.Advance(2);
  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("alert after medium: 7"));
}

TEST(RobotStateTest, NewRulesRunAfterASwap) {
  TestRules before;
  before.Msg("before", Call(Builtin::kTopicIn, Texts({"/t"})), {{Alert("x")}});
  TestRobot robot(before);
  EXPECT_EQ(robot.Message("/t").fired, 1u);
  TestRules after;
  after.Msg("after", Not(Call(Builtin::kTopicIn, Texts({"/t"}))), {{Alert("x")}});
  EXPECT_THAT(robot.state.SwapProgram(after.Build()), IsOk());

  EXPECT_EQ(robot.Message("/t").fired, 0u);
  EXPECT_EQ(robot.Message("/u").fired, 1u);
}

TEST(RobotStateTest, MovesWithItsParkedChains) {
  TestRobot robot(Parks());
  robot.Tick();

  RobotState moved = std::move(robot.state);

  EXPECT_EQ(OnProgramResult(1, true, robot.now, moved).effects.size(), 2u);
}

TEST(ProgramTest, RefusesABadRegex) {
  TestRules rules;
  rules.Msg("r", Call(Builtin::kTopicMatches, Texts({"("})), {{Alert("x")}});
  EXPECT_THAT(CompiledPolicy::Create(rules.rules).status(),
              StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr("rule `r`")));
}

TEST(ProgramTest, RefusesARegexThatWouldTakeTooMuchMemory) {
  TestRules rules;
  rules.Msg("r", Call(Builtin::kTopicMatches, Texts({"((((a{100}){100}){100}){100})"})),
            {{Alert("x")}});
  EXPECT_THAT(CompiledPolicy::Create(rules.rules).status(),
              StatusIs(absl::StatusCode::kInvalidArgument));
  TestRules wide;
  wide.Msg("r", Call(Builtin::kTopicMatches, Texts({"((\\pL\\pN){20}){40}"})), {{Alert("x")}});
  EXPECT_THAT(CompiledPolicy::Create(wide.rules).status(),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(ProgramTest, RefusesARegexThatIsNotConstant) {
  TestRules rules;
  const uint32_t s = rules.Var("s", ValueType::kString, std::string("x"));
  rules.Msg("r", Call(Builtin::kTopicMatches, {V(s)}), {{Alert("x")}});
  EXPECT_THAT(CompiledPolicy::Create(rules.rules).status(),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

}  // namespace
}  // namespace rips::engine
