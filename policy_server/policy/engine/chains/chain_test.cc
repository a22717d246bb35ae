// exec and trigger: chains that wait for the robot.
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

constexpr int64_t kSecond = kNanosPerSecond;

// RIPS paper, "Actions": rule R with its three chains.
TestRules RuleR() {
  TestRules rules;
  rules.Tick("R", Op(Name(Predefined::kCurrLevel), BinaryOp::kLt, L(3)),
             {{Alert("info: rule R activated")},
              {Exec({"usb_alarm"}) >> kElse, Alert("warning: usb_alarm failed")},
              {Trigger(3)}});
  return rules;
}

TEST(ChainTest, RunsThePapersRuleR) {
  TestRobot robot(RuleR());

  EXPECT_THAT(Lines(robot.Tick(), robot.state),
              ElementsAre("alert R medium: info: rule R activated", "run 1 R: usb_alarm",
                          "level R A->D 1.2"));
  EXPECT_THAT(Lines(OnProgramResult(1, false, robot.now, robot.state), robot.state),
              ElementsAre("alert R medium: warning: usb_alarm failed"));
}

TEST(ChainTest, RuleRDoesNotWarnIfTheAlarmWorks) {
  TestRobot robot(RuleR());
  robot.Tick();

  EXPECT_THAT(OnProgramResult(1, true, robot.now, robot.state).effects, IsEmpty());
}

TEST(ChainTest, UnknownAndRepeatedResultsDoNothing) {
  TestRobot robot(RuleR());
  robot.Tick();

  EXPECT_THAT(OnProgramResult(0, false, robot.now, robot.state).effects, IsEmpty());
  EXPECT_THAT(OnProgramResult(2, false, robot.now, robot.state).effects, IsEmpty());
  EXPECT_EQ(OnProgramResult(1, false, robot.now, robot.state).effects.size(), 1u);
  EXPECT_THAT(OnProgramResult(1, false, robot.now, robot.state).effects, IsEmpty());
}

TEST(ChainTest, ReadsVariablesAndLevelWhenItResumes) {
  TestRules rules;
  const uint32_t x = rules.IntVar("x", 1);
  rules.Msg("m", Op(V(x), BinaryOp::kEq, I(1)),
            {{Exec({"p"}) >> kThen, Alert(Concat(Concat(Text(V(x)), Name(Predefined::kLevel)),
                                                 Text(Call(Builtin::kTopicIn, Texts({"/t"})))))}});
  rules.Tick("t", B(true), {{Set(x, I(2)) >> kThen, Trigger(2)}});
  TestRobot robot(rules);
  robot.Message("/t");
  robot.Tick();

  // Of the event that started it, the topic is still known.
  EXPECT_THAT(Lines(OnProgramResult(1, true, robot.now, robot.state), robot.state),
              ElementsAre("alert m medium: 2Ctrue"));
}

TEST(ChainTest, IdenticalProgramsInFlightAreJoined) {
  TestRules rules;
  rules.Tick("a", B(true), {{Exec({"p", "x"}) >> kThen, Alert("a")}});
  rules.Tick("b", B(true), {{Exec({"p", "x"}) >> kThen, Alert("b")}});
  rules.Tick("c", B(true), {{Exec({"p", "y"}) >> kThen, Alert("c")}});
  rules.Tick("d", B(true), {{Exec({"p", "x"})}});
  TestRobot robot(rules);

  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("run 1 a: p x", "run 2 c: p y"));
  EXPECT_THAT(Lines(OnProgramResult(1, true, robot.now, robot.state), robot.state),
              ElementsAre("alert a medium: a", "alert b medium: b"));
  // Over: the next one is a run of its own.
  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("run 3 a: p x"));
}

TEST(ChainTest, LateEventsRunNoPrograms) {
  TestRules rules;
  rules.Tick("r", B(true), {{Exec({"p"}) >> kElse, Alert("not run")}});
  TestRobot robot(rules);

  const Outcome outcome = robot.Tick(levels::Lateness::kLate);

  EXPECT_THAT(Lines(outcome, robot.state), ElementsAre("alert r medium: not run"));
  ASSERT_EQ(outcome.refused_programs.size(), 1u);
  EXPECT_EQ(outcome.refused_programs[0].rule, "r");
  EXPECT_EQ(outcome.refused_programs[0].program, "p");
  EXPECT_EQ(outcome.refused_programs[0].reason, "late");
}

TEST(ChainTest, AProgramHasTenSeconds) {
  TestRobot robot(RuleR());
  robot.Tick();

  robot.Advance(10 * kSecond - 1);
  EXPECT_THAT(Expire(robot.now, robot.state).effects, IsEmpty());
  robot.Advance(1);
  EXPECT_THAT(Lines(Expire(robot.now, robot.state), robot.state),
              ElementsAre("alert R medium: warning: usb_alarm failed"));
  EXPECT_THAT(Expire(robot.now, robot.state).effects, IsEmpty());
  EXPECT_THAT(OnProgramResult(1, false, robot.now, robot.state).effects, IsEmpty());
}

TEST(ChainTest, DeadlinesDoNotCareForTheWallClock) {
  TestRobot robot(RuleR());
  robot.Tick();

  robot.now.unix_ns += 1'000'000 * kSecond;
  EXPECT_THAT(Expire(robot.now, robot.state).effects, IsEmpty());
}

TestRules Raise(int64_t level) {
  TestRules rules;
  rules.Tick("r", Op(Name(Predefined::kCurrLevel), BinaryOp::kLt, L(level)),
             {{Trigger(level) >> kThen, Alert("done")}, {Alert("meanwhile")}});
  return rules;
}

TEST(ChainTest, TriggerWaitsForVerification) {
  TestRobot robot(Raise(2));
  robot.state.actuation = Actuation::kVerified;

  EXPECT_THAT(Lines(robot.Tick(), robot.state),
              ElementsAre("level r A->C 1.2", "alert r medium: meanwhile"));
  EXPECT_THAT(OnActuation(robot.now, robot.state).effects, IsEmpty());
  EXPECT_THAT(Lines(robot.Verified(), robot.state), ElementsAre("alert r medium: done"));
  EXPECT_THAT(robot.Verified().effects, IsEmpty());
}

TEST(ChainTest, TriggerIsFalseAtOnceWithoutALease) {
  TestRules rules;
  rules.Tick("r", B(true), {{Trigger(2) >> kElse, Alert("nobody obeys")}});
  TestRobot robot(rules);

  EXPECT_THAT(Lines(robot.Tick(), robot.state),
              ElementsAre("level r A->C 1.2", "alert r medium: nobody obeys"));
  EXPECT_EQ(robot.state.level.level(), 2);
}

TEST(ChainTest, TriggerIsFalseWhenActuationFailsOrTheLeaseGoes) {
  for (const Actuation end : {Actuation::kFailed, Actuation::kNoLease}) {
    TestRules rules;
    rules.Tick("r", B(true), {{Trigger(2) >> kElse, Alert("failed")}});
    TestRobot robot(rules);
    robot.state.actuation = Actuation::kPending;
    robot.Tick();

    robot.state.actuation = end;
    EXPECT_THAT(Lines(OnActuation(robot.now, robot.state), robot.state),
                ElementsAre("alert r medium: failed"));
    EXPECT_EQ(robot.state.level.level(), 2) << "the decision stands";
  }
}

TEST(ChainTest, TriggerHasTwentyFiveSeconds) {
  TestRules rules;
  rules.Tick("r", Op(Name(Predefined::kCurrLevel), BinaryOp::kLt, L(2)),
             {{Trigger(2) >> kElse, Alert("failed")}});
  TestRobot robot(rules);
  robot.state.actuation = Actuation::kPending;
  robot.Tick();

  robot.Advance(25 * kSecond - 1);
  EXPECT_THAT(Expire(robot.now, robot.state).effects, IsEmpty());
  robot.Advance(1);
  EXPECT_THAT(Lines(Expire(robot.now, robot.state), robot.state),
              ElementsAre("alert r medium: failed"));
  EXPECT_THAT(robot.Verified().effects, IsEmpty());
}

TEST(ChainTest, NothingIsParkedIfNothingFollows) {
  TestRules rules;
  rules.Tick("r", B(true), {{Trigger(Name(Predefined::kCurrLevel))}, {Exec({"p"})}});
  TestRobot robot(rules);
  robot.state.actuation = Actuation::kPending;

  for (int i = 0; i < 200; ++i) {
    const Outcome outcome = robot.Tick();
    EXPECT_EQ(outcome.effects.size(), i == 0 ? 1u : 0u);
    EXPECT_THAT(outcome.refused_programs, IsEmpty());
  }
}

TEST(ChainTest, ARaiseIsTrueWhenAHigherOneIsVerified) {
  TestRobot robot(Raise(1));
  robot.state.actuation = Actuation::kPending;
  robot.Tick();
  robot.state.level.Raise(3, {}, robot.now);

  EXPECT_THAT(OnActuation(robot.now, robot.state).effects, IsEmpty());
  EXPECT_THAT(Lines(robot.Verified(), robot.state), ElementsAre("alert r medium: done"));
}

TEST(ChainTest, ARaiseIsFalseOnceTheLevelIsBelow) {
  TestRules rules;
  rules.Tick("r", Op(Name(Predefined::kCurrLevel), BinaryOp::kEq, L(0)),
             {{Trigger(2) >> kElse, Alert("overtaken")}});
  TestRobot robot(rules);
  robot.state.actuation = Actuation::kPending;
  robot.Tick();
  robot.state.level.DeEscalate(1, {}, robot.now, 2, robot.state.level.decision_id());

  EXPECT_THAT(Lines(OnActuation(robot.now, robot.state), robot.state),
              ElementsAre("alert r medium: overtaken"));
}

TEST(ChainTest, ALoweringIsTrueOnlyAtItsLevel) {
  TestRules rules;
  rules.Tick("r", B(true), {{Trigger(1) >> kThen, Alert("down")}});
  TestRobot robot(rules, 2);
  robot.state.actuation = Actuation::kVerified;
  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("level r C->B 1.2"));
  EXPECT_THAT(Lines(robot.Verified(), robot.state), ElementsAre("alert r medium: down"));
}

TEST(ChainTest, ALoweringThatWasOvertakenIsFalse) {
  TestRules rules;
  rules.Tick("r", B(true), {{Trigger(1) >> kElse, Alert("overtaken")}});
  TestRobot robot(rules, 2);
  robot.state.actuation = Actuation::kVerified;
  robot.Tick();
  robot.state.level.Raise(3, {}, robot.now);

  EXPECT_THAT(Lines(robot.Verified(), robot.state), ElementsAre("alert r medium: overtaken"));
}

TEST(ChainTest, AllWaitingChainsAreAnsweredBeforeOneGoesOn) {
  TestRules rules;
  rules.Graph("a", B(true), {{Trigger(1) >> kThen, Trigger(3)}});
  rules.Graph("b", B(true), {{Trigger(1) >> kThen, Alert("b")}});
  TestRobot robot(rules);
  robot.state.actuation = Actuation::kVerified;
  robot.Graph();

  // What `a` goes on with makes the level pending again; `b` was verified all the same.
  EXPECT_THAT(Lines(robot.Verified(), robot.state),
              ElementsAre("level a B->D 1.3", "alert b medium: b"));
  EXPECT_EQ(robot.state.actuation, Actuation::kPending);
}

TEST(ChainTest, ChainsParkAgainAndAgain) {
  TestRules rules;
  rules.Tick(
      "r", Op(Name(Predefined::kCurrLevel), BinaryOp::kEq, L(0)),
      {{Exec({"p", "1"}) >> kThen, Exec({"p", "2"}) >> kElse, Trigger(3) >> kThen, Alert("end")}});
  TestRobot robot(rules);
  robot.state.actuation = Actuation::kVerified;

  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("run 1 r: p 1"));
  robot.Advance(9 * kSecond);
  EXPECT_THAT(Lines(OnProgramResult(1, true, robot.now, robot.state), robot.state),
              ElementsAre("run 2 r: p 2"));
  robot.Advance(9 * kSecond);
  EXPECT_THAT(Expire(robot.now, robot.state).effects, IsEmpty());
  EXPECT_THAT(Lines(OnProgramResult(2, false, robot.now, robot.state), robot.state),
              ElementsAre("level r A->D 1.2"));
  EXPECT_THAT(Lines(robot.Verified(), robot.state), ElementsAre("alert r medium: end"));
}

TEST(ChainTest, AFaultAfterResumingIsReported) {
  TestRules rules;
  rules.Tick("r", B(true), {{Exec({"p"}) >> kThen, Alert(Text(Faulty())) >> kElse, Alert("on")}});
  TestRobot robot(rules);
  robot.Tick();

  const Outcome outcome = OnProgramResult(1, true, robot.now, robot.state);

  EXPECT_EQ(outcome.faults, 1u);
  EXPECT_THAT(Lines(outcome, robot.state),
              ElementsAre(HasSubstr("division by zero"), "alert r medium: on"));
}

TEST(ChainTest, TheSixtyFifthChainFailsAtOnce) {
  TestRules rules;
  rules.Tick("r", B(true), {{Exec({"p"}) >> kElse, Alert("failed")}});
  TestRobot robot(rules);
  for (int i = 0; i < 64; ++i) EXPECT_THAT(robot.Tick().refused_programs, IsEmpty());

  const Outcome first = robot.Tick();
  EXPECT_THAT(
      Lines(first, robot.state),
      ElementsAre(AllOf(HasSubstr("alert r high"), HasSubstr("64")), "alert r medium: failed"));
  ASSERT_EQ(first.refused_programs.size(), 1u);
  EXPECT_EQ(first.refused_programs[0].reason, "too many in flight");
  // The alert about it at most once a second.
  robot.Advance(kSecond - 1);
  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("alert r medium: failed"));
  robot.Advance(1);
  EXPECT_EQ(robot.Tick().effects.size(), 2u);
  // All 64 go on; then there is room.
  EXPECT_EQ(OnProgramResult(1, false, robot.now, robot.state).effects.size(), 64u);
  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("run 2 r: p"));
}

TEST(ChainTest, SixtyFourProgramsAtMostAreUnderWay) {
  TestRules rules;
  const uint32_t x = rules.IntVar("x", 0);
  TypedAction exec{.kind = lang::ActionKind::kExec, .args = {S("p"), Text(V(x))}};
  rules.Tick("r", B(true), {{exec}, {Set(x, Op(V(x), BinaryOp::kAdd, I(1)))}});
  TestRobot robot(rules);
  size_t runs = 0;
  size_t refused = 0;
  for (int i = 0; i < 100; ++i) {
    const Outcome outcome = robot.Tick();
    for (const Effect& effect : outcome.effects) {
      runs += std::holds_alternative<RunProgramEffect>(effect);
    }
    refused += outcome.refused_programs.size();
  }

  EXPECT_EQ(runs, 64u);
  EXPECT_EQ(refused, 36u);
}

TEST(ChainTest, AFullHouseDoesNotHoldUpARaise) {
  TestRules rules;
  rules.Tick("r", B(true), {{Exec({"p"}) >> kThen, Alert("x")}});
  rules.Graph("raise", B(true), {{Trigger(3) >> kElse, Alert("not waited for")}});
  TestRobot robot(rules);
  robot.state.actuation = Actuation::kVerified;
  for (int i = 0; i < 64; ++i) robot.Tick();

  EXPECT_THAT(Lines(robot.Graph(), robot.state),
              ElementsAre("level raise A->D 1.2", HasSubstr("alert raise high"),
                          "alert raise medium: not waited for"));
  EXPECT_EQ(robot.state.level.level(), 3);
}

// A robot that answers at once, and what it was asked.
class Script final : public ScriptedRobot {
 public:
  bool RunProgram(absl::string_view program, const std::vector<std::string>& args) override {
    asked.push_back(absl::StrCat(program, " ", args.size()));
    return program != "bad";
  }
  bool Reach(levels::LevelIndex level) override {
    asked.push_back(absl::StrCat(level));
    return level != 2;
  }
  std::vector<std::string> asked;
};

TEST(ChainTest, AScriptedRobotAnswersBeforeTheNextChain) {
  TestRules rules;
  rules.Tick("r", B(true),
             {{Exec({"good", "x"}) >> kThen, Alert("ran")},
              {Exec({"bad"}) >> kElse, Alert("failed")},
              {Exec({"good", "x"})},
              {Trigger(1) >> kThen, Alert("reached")},
              {Trigger(2) >> kElse, Alert("not reached")},
              {Trigger(2) >> kElse, Alert("still not")}});
  TestRobot robot(rules);
  Script script;
  robot.state.scripted = &script;

  EXPECT_THAT(Lines(robot.Tick(), robot.state),
              ElementsAre("run 1 r: good x", "alert r medium: ran", "run 2 r: bad",
                          "alert r medium: failed", "run 3 r: good x", "level r A->B 1.2",
                          "alert r medium: reached", "level r B->C 1.3",
                          "alert r medium: not reached", "alert r medium: still not"));
  EXPECT_THAT(script.asked, ElementsAre("good 1", "bad 0", "good 1", "1", "2", "2"));
  EXPECT_THAT(OnProgramResult(2, true, robot.now, robot.state).effects, IsEmpty());
  robot.Advance(30 * kSecond);
  EXPECT_THAT(Expire(robot.now, robot.state).effects, IsEmpty());
}

TEST(ChainTest, AScriptedRobotIsNotAskedForWhatIsRefused) {
  TestRules rules;
  rules.Tick("r", B(true),
             {{Exec({"p"}) >> kElse, Alert("late")}, {Trigger(0) >> kElse, Alert("no")}});
  TestRobot robot(rules, 3);
  Script script;
  robot.state.scripted = &script;

  EXPECT_THAT(Lines(robot.Tick(levels::Lateness::kLate), robot.state),
              ElementsAre("alert r medium: late", "refused r D->A needs an operator x1",
                          "alert r medium: no"));
  EXPECT_THAT(script.asked, IsEmpty());
}

}  // namespace
}  // namespace rips::engine
