// alert, set, trigger's decision, faults: what happens within one event.
#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<std::string> TickOnce(const TestRules& rules) {
  TestRobot robot(rules);
  return Lines(robot.Tick(), robot.state);
}

TEST(ActionTest, AlertSaysWhoAndAtWhichDecision) {
  TestRules rules;
  rules.Tick("r", B(true), {{Alert("one") >> kThen, Trigger(2) >> kAnyway, Alert("two")}});
  TestRobot robot(rules);

  const Outcome outcome = robot.Tick();

  const auto& one = std::get<AlertEffect>(outcome.effects.at(0));
  EXPECT_EQ(one.rule, "r");
  EXPECT_EQ(one.severity, Severity::kMedium);
  EXPECT_EQ(one.text, "one");
  EXPECT_EQ(one.level, 0);
  EXPECT_EQ(one.decision_id, (DecisionId{1, 1}));
  const auto& two = std::get<AlertEffect>(outcome.effects.at(2));
  EXPECT_EQ(two.level, 2);
  EXPECT_EQ(two.decision_id, (DecisionId{1, 2}));
}

TEST(ActionTest, AlertTakesASeverity) {
  for (const char* severity : {"info", "low", "medium", "high", "critical"}) {
    TestRules rules;
    rules.Tick("r", B(true), {{TypedAction{.args = Texts({"x", severity})}}});
    EXPECT_THAT(TickOnce(rules), ElementsAre(absl::StrCat("alert r ", severity, ": x")));
  }
  TestRules unknown;
  unknown.Tick("r", B(true), {{TypedAction{.args = {S("x"), Concat(S("ur"), S("gent"))}}}});
  EXPECT_THAT(TickOnce(unknown), ElementsAre("alert r medium: x"));
}

// Repairs of the prototype, whose optimiser joined both and whose generator ignored connectors.
TEST(ActionTest, SetTwiceCountsTwice) {
  TestRules rules;
  const uint32_t x = rules.IntVar("x", 0);
  const TypedExpr next = Op(V(x), BinaryOp::kAdd, I(1));
  rules.Tick("r", B(true), {{Set(x, next) >> kAnyway, Set(x, next)}});
  TestRobot robot(rules);

  EXPECT_TRUE(robot.Tick().variables_changed);
  EXPECT_EQ(robot.Int("x"), 2);
  robot.Tick();
  EXPECT_EQ(robot.Int("x"), 4);
}

TEST(ActionTest, AnAlertBetweenTwoSetsHappens) {
  TestRules rules;
  const uint32_t x = rules.IntVar("x", 0);
  rules.Tick(
      "r", B(true),
      {{Set(x, I(1)) >> kAnyway, Alert(Concat(S("x is "), Text(V(x)))) >> kAnyway, Set(x, I(2))}});
  TestRobot robot(rules);

  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("alert r medium: x is 1"));
  EXPECT_EQ(robot.Int("x"), 2);
}

TEST(ActionTest, SettingTheSameValueChangesNothing) {
  TestRules rules;
  const uint32_t x = rules.IntVar("x", 7);
  rules.Tick("r", B(true), {{Set(x, V(x))}});
  TestRobot robot(rules);

  EXPECT_FALSE(robot.Tick().variables_changed);
}

TEST(ActionTest, SetCopiesTextOfItsOwnVariable) {
  TestRules rules;
  const uint32_t s = rules.Var("s", ValueType::kString, std::string("a string of some length"));
  rules.Tick("r", B(true), {{Set(s, V(s)) >> kThen, Set(s, Concat(V(s), S("!")))}});
  TestRobot robot(rules);

  robot.Tick();

  EXPECT_EQ(std::get<std::string>(robot.state.Variables().at("s")), "a string of some length!");
}

// {succeeded, failed, fault} x {=>, !>, ','}
TEST(ActionTest, ConnectorsDecideWhetherTheChainGoesOn) {
  const auto first = [](int i) {
    // No lease: trigger of the level that holds is false at once.
    return i == 0 ? Alert("ok") : i == 1 ? Trigger(0) : Alert(Text(Op(I(1), BinaryOp::kMod, I(0))));
  };
  const bool want[3][3] = {{true, false, true}, {false, true, true}, {false, true, true}};
  const Connector connectors[] = {kThen, kElse, kAnyway};
  for (int a = 0; a < 3; ++a) {
    for (int c = 0; c < 3; ++c) {
      TestRules rules;
      rules.Tick("r", B(true), {{first(a) >> connectors[c], Alert("next")}});
      const std::vector<std::string> lines = TickOnce(rules);
      EXPECT_EQ(!lines.empty() && lines.back() == "alert r medium: next", want[a][c])
          << a << " " << c;
    }
  }
}

TEST(ActionTest, AConnectorThatSaysNoEndsTheWholeChain) {
  TestRules rules;
  rules.Tick("r", B(true),
             {{Alert("a") >> kElse, Alert("b") >> kAnyway, Alert("c")}, {Alert("d")}});

  EXPECT_THAT(TickOnce(rules), ElementsAre("alert r medium: a", "alert r medium: d"));
}

TEST(ActionTest, RulesRunInOrderAndSeeWhatEarlierOnesDid) {
  TestRules rules;
  const uint32_t x = rules.IntVar("x", 0);
  rules.Tick("first", B(true),
             {{
                  Set(x, I(1)),
              },
              {Trigger(1)}});
  rules.Graph("other", B(true), {{Alert("not an external rule")}});
  rules.Tick(
      "second",
      And(Op(V(x), BinaryOp::kEq, I(1)), Op(Name(Predefined::kCurrLevel), BinaryOp::kEq, L(1))),
      {{Alert(Name(Predefined::kLevel))}});
  TestRobot robot(rules);

  const Outcome outcome = robot.Tick();

  EXPECT_EQ(outcome.fired, 2u);
  EXPECT_THAT(Lines(outcome, robot.state),
              ElementsAre("level first A->B 1.2", "alert second medium: B"));
}

TEST(ActionTest, EventsRunTheRulesOfTheirClass) {
  TestRules rules;
  rules.Tick("t", B(true), {{Alert("t")}});
  rules.Graph("g", B(true), {{Alert("g")}});
  rules.Msg("m", B(true), {{Alert("m")}});
  TestRobot robot(rules);

  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("alert t medium: t"));
  EXPECT_THAT(Lines(robot.Graph(), robot.state), ElementsAre("alert g medium: g"));
  EXPECT_THAT(Lines(robot.Message("/x"), robot.state), ElementsAre("alert m medium: m"));
  for (const ExternalEvent& event :
       {ExternalEvent(model::IdsAlert{}), ExternalEvent(model::SignalSeen{}),
        ExternalEvent(AgentEvent{}), ExternalEvent(model::Loss{})}) {
    EXPECT_THAT(Lines(robot.Judge(event), robot.state), ElementsAre("alert t medium: t"));
  }
}

TEST(ActionTest, AFaultStopsOneRuleOnly) {
  TestRules rules;
  rules.Tick("bad", Not(Faulty()), {{Alert("never")}});
  rules.Tick("good", B(true), {{Alert("fine")}});
  TestRobot robot(rules);

  const Outcome outcome = robot.Tick();

  EXPECT_EQ(outcome.faults, 1u);
  EXPECT_EQ(outcome.fired, 1u);
  EXPECT_THAT(Lines(outcome, robot.state),
              ElementsAre("alert bad high: fault in rule `bad`: integer division by zero; it did "
                          "not fire",
                          "alert good medium: fine"));
}

TEST(ActionTest, AFaultInAnActionKeepsWhatWasDoneAndDropsOtherChains) {
  TestRules rules;
  const uint32_t x = rules.IntVar("x", 0);
  const TypedExpr bad = Op(I(1), BinaryOp::kDiv, V(x));
  rules.Tick("r", B(true),
             {{Alert("before") >> kThen, Set(x, bad) >> kThen, Alert("after")}, {Alert("other")}});
  TestRobot robot(rules);

  const Outcome outcome = robot.Tick();

  EXPECT_EQ(outcome.faults, 1u);
  EXPECT_EQ(outcome.fired, 1u);
  EXPECT_FALSE(outcome.variables_changed);
  EXPECT_EQ(robot.Int("x"), 0);
  EXPECT_THAT(Lines(outcome, robot.state),
              ElementsAre("alert r medium: before", HasSubstr("the action failed")));
}

TEST(ActionTest, FaultsAreAlertedOnceASecondAndRule) {
  TestRules rules;
  rules.Tick("a", Faulty(), {{Alert("x")}});
  rules.Tick("b", Faulty(), {{Alert("x")}});
  TestRobot robot(rules);
  const auto alerts = [&] {
    const Outcome outcome = robot.Tick();
    EXPECT_EQ(outcome.faults, 2u);
    return outcome.effects.size();
  };

  EXPECT_EQ(alerts(), 2u);
  robot.Advance(kNanosPerSecond - 1);
  EXPECT_EQ(alerts(), 0u);
  robot.Advance(1);
  EXPECT_EQ(alerts(), 2u);
  // By the time of events: the wall clock jumping back does not open the gate.
  robot.now.unix_ns -= 100 * kNanosPerSecond;
  EXPECT_EQ(alerts(), 0u);
}

TEST(ActionTest, TriggerDecidesAtOnce) {
  TestRules rules;
  rules.Tick("r", Op(Name(Predefined::kCurrLevel), BinaryOp::kLt, L(3)), {{Trigger(3)}});
  TestRobot robot(rules);
  robot.state.actuation = Actuation::kVerified;

  const Outcome outcome = robot.Tick();

  EXPECT_THAT(Lines(outcome, robot.state), ElementsAre("level r A->D 1.2"));
  EXPECT_EQ(robot.state.actuation, Actuation::kPending);
  const auto& transition = std::get<TransitionEffect>(outcome.effects[0]).transition;
  EXPECT_EQ(transition.based_on, (DecisionId{1, 1}));
  EXPECT_EQ(transition.at, robot.now);
  EXPECT_THAT(robot.Tick().effects, IsEmpty());
}

TEST(ActionTest, ADecisionIsPendingOnlyIfSomebodyObeys) {
  const std::pair<Actuation, Actuation> kCases[] = {
      {Actuation::kNoLease, Actuation::kNoLease},
      {Actuation::kPending, Actuation::kPending},
      {Actuation::kVerified, Actuation::kPending},
      {Actuation::kFailed, Actuation::kPending},
  };
  for (const auto& [before, after] : kCases) {
    TestRules rules;
    rules.Tick("r", B(true), {{Trigger(1)}});
    TestRobot robot(rules);
    robot.state.actuation = before;
    robot.Tick();
    EXPECT_EQ(robot.state.actuation, after);
  }
}

TEST(ActionTest, TriggerOfTheCurrentLevelRecordsNothing) {
  TestRules rules;
  rules.Tick("r", B(true), {{Trigger(Name(Predefined::kCurrLevel)) >> kThen, Alert("held")}});
  TestRobot robot(rules, 2);
  robot.state.actuation = Actuation::kVerified;

  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("alert r medium: held"));
  EXPECT_EQ(robot.state.actuation, Actuation::kVerified);
  robot.state.actuation = Actuation::kFailed;
  EXPECT_THAT(robot.Tick().effects, IsEmpty());
}

TEST(ActionTest, LowersByOneFromASoftLevelWithEvidence) {
  TestRules rules;
  rules.Tick("r", B(true), {{Trigger(0)}});

  TestRobot robot(rules, 1);
  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("level r B->A 1.2"));
  TestRobot blind(rules, 1);
  blind.state.evidence.blind_because = {"sensor lost"};
  EXPECT_THAT(Lines(blind.Tick(), blind.state), ElementsAre("refused r B->A blind x1"));
  TestRobot late(rules, 1);
  EXPECT_THAT(Lines(late.Tick(levels::Lateness::kLate), late.state),
              ElementsAre("refused r B->A late x1"));
  TestRobot far(rules, 2);
  EXPECT_THAT(Lines(far.Tick(), far.state), ElementsAre("refused r C->A needs an operator x1"));
  TestRobot hard(rules, 3);
  EXPECT_THAT(Lines(hard.Tick(), hard.state), ElementsAre("refused r D->A needs an operator x1"));
}

TEST(ActionTest, LateEventsStillAlertSetAndRaise) {
  TestRules rules;
  const uint32_t x = rules.IntVar("x", 0);
  rules.Tick("r", B(true), {{Alert("a") >> kThen, Set(x, I(1)) >> kThen, Trigger(2)}});
  TestRobot robot(rules);

  EXPECT_THAT(Lines(robot.Tick(levels::Lateness::kLate), robot.state),
              ElementsAre("alert r medium: a", "level r A->C 1.2"));
  EXPECT_EQ(robot.Int("x"), 1);
}

TEST(ActionTest, ARefusalIsCountedUntilSomethingChanges) {
  TestRules rules;
  rules.Tick("r", B(true), {{Trigger(0)}, {Trigger(1)}});
  TestRobot robot(rules, 3);
  const auto lines = [&] { return Lines(robot.Tick(), robot.state); };

  EXPECT_THAT(lines(), ElementsAre("refused r D->A needs an operator x1",
                                   "refused r D->B needs an operator x1"));
  EXPECT_THAT(lines(), ElementsAre("refused r D->A needs an operator x2",
                                   "refused r D->B needs an operator x2"));
  // Another stay at the same level, and another reason, begin anew.
  robot.state.level.DeEscalate(1, {}, robot.now, 3, robot.state.level.decision_id());
  robot.state.evidence.blind_because = {"x"};
  EXPECT_THAT(lines(), ElementsAre("refused r B->A blind x1"));
  EXPECT_THAT(lines(), ElementsAre("refused r B->A blind x2"));
  EXPECT_THAT(Lines(robot.Tick(levels::Lateness::kLate), robot.state),
              ElementsAre("refused r B->A late x1"));
  robot.state.level.Raise(3, {}, robot.now);
  EXPECT_THAT(lines(), ElementsAre("refused r D->A needs an operator x1",
                                   "refused r D->B needs an operator x1"));
}

TEST(ActionTest, TriggerOfNoLevelIsAFault) {
  TestRules rules;
  const uint32_t x = rules.IntVar("x", 0);
  rules.Tick("r", B(true), {{Set(x, I(4)) >> kThen, Trigger(V(x)) >> kElse, Alert("else")}});
  TestRobot robot(rules, 3);

  const Outcome outcome = robot.Tick();

  EXPECT_EQ(outcome.faults, 1u);
  EXPECT_EQ(robot.state.level.level(), 3);
  EXPECT_THAT(
      Lines(outcome, robot.state),
      ElementsAre(HasSubstr("`trigger` of a level that does not exist"), "alert r medium: else"));
}

TEST(ActionTest, DescribesEvents) {
  EXPECT_EQ(Describe({.what = MessageEvent{.topic = "/cmd_vel", .sender = "/intruder"}}),
            "message on /cmd_vel from /intruder");
  EXPECT_EQ(Describe({.what = MessageEvent{.topic = "/t"}}),
            "message on /t from (unattributed 00000000.00000000.00000000.00000000)");
  EXPECT_EQ(Describe({.what = GraphEvent{}}), "graph change");
  EXPECT_EQ(Describe({.what = ExternalEvent(TickEvent{})}), "tick");
  EXPECT_EQ(Describe({.what = ExternalEvent(AgentEvent{"sensor", "lost"})}), "sensor lost");
  EXPECT_EQ(Describe({.what = ExternalEvent(model::SignalSeen{"SIGUSR1"})}), "signal SIGUSR1");
  EXPECT_EQ(Describe({.what = ExternalEvent(model::Loss{3})}), "loss of 3 events");
  EXPECT_EQ(
      Describe({.what = ExternalEvent(model::IdsAlert{.gid = 1, .sid = 7, .message = "scan"})}),
      "ids alert 1:7 scan");
}

}  // namespace
}  // namespace rips::engine
