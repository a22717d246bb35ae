// What is asked of the event itself: sender, size, counts, and external events.
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

// The writer of TestGraph's participant number `n`.
ros2::Guid Writer(uint8_t n) {
  ros2::Guid guid;
  guid.bytes = {1, 0, 0, n, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 9, 3};
  return guid;
}

bool AskMessage(TypedExpr condition, const MessageEvent& message,
                const ros2::RosGraph& graph = ros2::RosGraph()) {
  TestRules rules;
  rules.Msg("r", std::move(condition), {{Alert("x")}});
  TestRobot robot(rules);
  robot.state.graph = graph;
  const Outcome outcome = robot.Judge(message);
  EXPECT_EQ(outcome.faults, 0u);
  return outcome.fired == 1;
}

TEST(MessageQuestionTest, SenderIsTheNodeThatWrote) {
  const auto in = [](const std::vector<std::string>& nodes) {
    return Call(Builtin::kSenderIn, Texts(nodes));
  };
  const MessageEvent message = {.topic = "/a", .sender = "/left/camera"};
  EXPECT_TRUE(AskMessage(in({"camera"}), message));
  EXPECT_TRUE(AskMessage(in({"x", "/left/camera"}), message));
  EXPECT_FALSE(AskMessage(in({"/camera", "left/camera", "amera"}), message));
  EXPECT_FALSE(AskMessage(in({}), message));
  EXPECT_FALSE(AskMessage(in({"", "camera"}), {.topic = "/a"})) << "not attributed";
}

TEST(MessageQuestionTest, AnEnclaveCountsOnlyIfItIsAuthenticated) {
  const auto graph = [](bool authenticated) {
    ros2::GraphDelta delta;
    delta.upsert_participants.push_back(
        {.guid = Writer(7).Participant(), .enclave = "/talker", .authenticated = authenticated});
    ros2::RosGraph out;
    EXPECT_THAT(out.Apply(delta), IsOk());
    return out;
  };
  const TypedExpr in = Call(Builtin::kSenderEnclave, Texts({"/x", "/talker"}));
  EXPECT_TRUE(AskMessage(in, {.topic = "/a", .writer = Writer(7)}, graph(true)));
  EXPECT_FALSE(AskMessage(in, {.topic = "/a", .writer = Writer(7)}, graph(false)));
  EXPECT_FALSE(AskMessage(in, {.topic = "/a", .writer = Writer(8)}, graph(true)));
  EXPECT_FALSE(AskMessage(in, {.topic = "/a"}, graph(true)));
}

TEST(MessageQuestionTest, SizeIsOfTheSerializedPayload) {
  const auto size = [](int64_t min, int64_t max) {
    return Call(Builtin::kPayloadSize, {I(min), I(max)});
  };
  const MessageEvent message = {.topic = "/a", .size_bytes = 100};
  EXPECT_TRUE(AskMessage(size(100, 100), message));
  EXPECT_FALSE(AskMessage(size(101, 200), message));
  EXPECT_FALSE(AskMessage(size(0, 99), message));
  EXPECT_FALSE(AskMessage(size(200, 0), message));
}

TEST(MessageQuestionTest, NamesOfTheMessage) {
  TestRules rules;
  rules.Msg("r", B(true),
            {{Alert(Concat(Concat(Name(Predefined::kTopic), S(" ")),
                           Concat(Concat(Name(Predefined::kMsgType), S(" ")),
                                  Concat(Concat(Name(Predefined::kSender), S(" ")),
                                         Concat(Concat(Name(Predefined::kSenderGuid), S(" ")),
                                                Name(Predefined::kRobot))))))}});
  TestRobot robot(rules);
  robot.state.robot_id = "r1";
  const Outcome outcome = robot.Judge(MessageEvent{
      .topic = "/a", .type = "std_msgs/msg/String", .writer = Writer(1), .sender = "/n"});
  EXPECT_THAT(Lines(outcome, robot.state), ElementsAre("alert r medium: /a std_msgs/msg/String /n "
                                                       "01000001.00000000.00000000.00000903 r1"));
}

class CountTest : public testing::Test {
 protected:
  // Fires of the only rule, on messages at these milliseconds.
  std::vector<int> FiresAt(TypedExpr condition, const std::vector<int>& at_ms,
                           const std::vector<int>& writers = {}) {
    TestRules rules;
    rules.Msg("r", std::move(condition), {{Alert("x")}});
    TestRobot robot(rules);
    const Instant start = robot.now;
    std::vector<int> fires;
    for (size_t i = 0; i < at_ms.size(); ++i) {
      robot.now = start;
      robot.Advance(at_ms[i] * kNanosPerMilli);
      const auto writer = static_cast<uint8_t>(i < writers.size() ? writers[i] : 1);
      const Outcome outcome = robot.Judge(
          MessageEvent{.topic = "/a", .writer = writer == 0 ? ros2::Guid() : Writer(writer)});
      if (outcome.fired == 1) fires.push_back(at_ms[i]);
    }
    return fires;
  }
};

TEST_F(CountTest, CountsThisMessageAndThoseWithinTheWindow) {
  const TypedExpr flood = Call(Builtin::kMsgCount, {I(100), I(3), I(1'000'000)});
  EXPECT_THAT(FiresAt(flood, {0, 50, 99, 100, 150, 300}), ElementsAre(99, 100, 150));
  const TypedExpr alone = Call(Builtin::kMsgCount, {I(100), I(1), I(1)});
  EXPECT_THAT(FiresAt(alone, {0, 50, 149, 150, 250, 400}), ElementsAre(0, 250, 400));
}

TEST_F(CountTest, CountsOneWriter) {
  const TypedExpr twice = Call(Builtin::kSenderCount, {I(100), I(2), I(9)});
  EXPECT_THAT(FiresAt(twice, {0, 1, 2, 3, 4}, {1, 2, 3, 2, 1}), ElementsAre(3, 4));
  EXPECT_THAT(FiresAt(twice, {0, 1, 2}, {0, 0, 0}), IsEmpty()) << "a writer that is not known";
}

TEST_F(CountTest, CountsAlsoWhereTheRestOfTheExpressionIsFalse) {
  TestRules rules;
  const uint32_t on = rules.Var("on", ValueType::kBool, false);
  rules.Msg("r", And(V(on), Call(Builtin::kMsgCount, {I(1'000), I(3), I(3)})), {{Alert("x")}});
  rules.Tick("t", B(true), {{Set(on, B(true))}});
  TestRobot robot(rules);
  robot.Message("/a");
  robot.Message("/a");
  robot.Tick();
  EXPECT_EQ(robot.Message("/a").fired, 1u);
}

TEST_F(CountTest, TopicsAreCountedApart) {
  TestRules rules;
  rules.Msg("r", Call(Builtin::kMsgCount, {I(1'000), I(2), I(9)}), {{Alert("x")}});
  TestRobot robot(rules);
  EXPECT_EQ(robot.Message("/a").fired, 0u);
  EXPECT_EQ(robot.Message("/b").fired, 0u);
  EXPECT_EQ(robot.Message("/a").fired, 1u);
}

bool AskExternal(TypedExpr condition, ExternalEvent event) {
  TestRules rules;
  rules.Tick("r", std::move(condition), {{Alert("x")}});
  TestRobot robot(rules);
  return robot.Judge(event).fired == 1;
}
template <typename What>
ExternalEvent Of(What what) {
  return ExternalEvent(std::in_place_type<What>, std::move(what));
}

TEST(ExternalQuestionTest, IdsAlerts) {
  const ExternalEvent ids =
      Of(model::IdsAlert{.gid = 1, .sid = 2001, .message = "ET SCAN 7 port sweep"});
  const auto ask = [&](const std::string& text) {
    return AskExternal(Call(Builtin::kIdsAlert, Texts({text})), ids);
  };
  EXPECT_TRUE(ask("2001"));
  EXPECT_TRUE(ask("1:2001"));
  EXPECT_TRUE(ask("port sweep"));
  EXPECT_TRUE(ask(""));
  EXPECT_FALSE(ask("2:2001"));
  EXPECT_FALSE(ask("7")) << "a number is a signature, not a part of the text";
  EXPECT_FALSE(ask("99999999999999999999"));
  EXPECT_FALSE(ask("Port Sweep")) << "case counts";
  EXPECT_FALSE(ask("1:2:3"));
  const ExternalEvent line =
      Of(model::IdsAlert{.message = "m", .line = "11/21 [**] [1:5:1] m {UDP}"});
  EXPECT_TRUE(AskExternal(Call(Builtin::kIdsAlert, Texts({"{UDP}"})), line));
}

TEST(ExternalQuestionTest, SignalsAgentsFindingsAndLosses) {
  const auto call = [](Builtin builtin, const std::vector<std::string>& args) {
    return Call(builtin, Texts(args));
  };
  const ExternalEvent signal = Of(model::SignalSeen{.name = "SIGUSR1"});
  EXPECT_TRUE(AskExternal(call(Builtin::kSignal, {"SIGUSR1"}), signal));
  EXPECT_TRUE(AskExternal(call(Builtin::kSignal, {"USR1"}), signal));
  EXPECT_FALSE(AskExternal(call(Builtin::kSignal, {"SIGUSR2"}), signal));
  const ExternalEvent lost = Of(AgentEvent{.agent = "sensor", .state = "lost"});
  EXPECT_TRUE(AskExternal(call(Builtin::kAgent, {"sensor", "lost"}), lost));
  EXPECT_FALSE(AskExternal(call(Builtin::kAgent, {"actuator", "lost"}), lost));
  EXPECT_FALSE(AskExternal(call(Builtin::kAgent, {"sensor", "connected"}), lost));
  const ExternalEvent finding = Of(model::Finding{.kind = "impostor"});
  EXPECT_TRUE(AskExternal(call(Builtin::kFinding, {"impostor"}), finding));
  EXPECT_FALSE(AskExternal(call(Builtin::kFinding, {"false_claim"}), finding));
  const ExternalEvent loss = Of(model::Loss{.count = 10});
  EXPECT_TRUE(AskExternal(Call(Builtin::kLostEvents, {I(10)}), loss));
  EXPECT_TRUE(AskExternal(Call(Builtin::kLostEvents, {I(-1)}), loss));
  EXPECT_FALSE(AskExternal(Call(Builtin::kLostEvents, {I(11)}), loss));
}

TEST(ExternalQuestionTest, NothingIsTrueOnATick) {
  const TypedExpr kAll[] = {
      Call(Builtin::kIdsAlert, Texts({""})),
      Call(Builtin::kSignal, Texts({"SIGUSR1"})),
      Call(Builtin::kAgent, Texts({"sensor", "lost"})),
      Call(Builtin::kFinding, Texts({"impostor"})),
      Call(Builtin::kLostEvents, {I(0)}),
  };
  for (const TypedExpr& question : kAll) {
    EXPECT_FALSE(AskExternal(question, Of(TickEvent{})));
    EXPECT_TRUE(AskExternal(Not(question), Of(TickEvent{})));
  }
}

TEST(ExternalQuestionTest, AddressesAreThoseOfTheIdsAlert) {
  const TypedExpr from = Op(Name(Predefined::kIdsSource), BinaryOp::kEq, S("10.0.0.1"));
  const TypedExpr to = Op(Name(Predefined::kIdsTarget), BinaryOp::kEq, S("10.0.0.2"));
  const ExternalEvent ids = Of(model::IdsAlert{.src = "10.0.0.1", .dst = "10.0.0.2"});
  EXPECT_TRUE(AskExternal(And(from, to), ids));
  EXPECT_FALSE(AskExternal(from, Of(TickEvent{})));
}

// A recording without a graph: what asks for it is not decided, and never guessed.
TEST(UndecidableTest, QuestionsAboutTheGraphAreNotDecided) {
  const TypedExpr kGraph[] = {
      Call(Builtin::kPublishers, Texts({})),
      Call(Builtin::kPublisherCount, {I(0), I(9)}),
      Call(Builtin::kNodeCount, {I(0), I(9)}),
      Call(Builtin::kNodesOnly, {Name(Predefined::kTopic)}),
  };
  for (const TypedExpr& question : kGraph) {
    for (const TypedExpr& condition : {question, Not(question), And(question, question)}) {
      TestRules rules;
      rules.Msg("r", condition, {{Alert("x")}});
      TestRobot robot(rules);
      robot.state.graph_known = false;
      const Outcome outcome = robot.Message("/a");
      EXPECT_EQ(outcome.fired, 0u);
      EXPECT_EQ(outcome.undecidable, 1u);
    }
    TestRules rules;
    rules.Msg("decided", Or(question, Call(Builtin::kTopicIn, Texts({"/a"}))), {{Alert("x")}});
    TestRobot robot(rules);
    robot.state.graph_known = false;
    EXPECT_EQ(robot.Message("/a").fired, 1u);
    EXPECT_EQ(robot.Message("/b").undecidable, 1u);
  }
}

TEST(UndecidableTest, AFindingStandsOrDoesNotOrThatIsNotKnown) {
  const TypedExpr impostor = Call(Builtin::kFindingStands, Texts({"impostor"}));
  const TypedExpr any = Call(Builtin::kFindingStands, Texts({"any"}));
  StandingFindings claim(/*told_all=*/true);
  claim.Add("false_claim");
  StandingFindings some;
  some.Add("impostor");
  // Of rules that ask for it and that ask for the opposite: how many fire, and are not decided.
  const auto ask = [](const TypedExpr& question, StandingFindings findings) {
    TestRules rules;
    rules.Tick("yes", question, {{Alert("x")}});
    rules.Tick("no", Not(question), {{Alert("y")}});
    TestRobot robot(rules);
    robot.state.findings = findings;
    const Outcome outcome = robot.Tick();
    EXPECT_EQ(outcome.faults, 0u);
    if (outcome.undecidable > 0) return absl::StrCat("not known: ", outcome.undecidable);
    return absl::StrJoin(Lines(outcome, robot.state), " ");
  };
  EXPECT_EQ(ask(impostor, StandingFindings()), "not known: 2");
  EXPECT_EQ(ask(any, StandingFindings()), "not known: 2");
  EXPECT_EQ(ask(impostor, StandingFindings(true)), "alert no medium: y");
  EXPECT_EQ(ask(any, StandingFindings(true)), "alert no medium: y");
  EXPECT_EQ(ask(impostor, claim), "alert no medium: y");
  EXPECT_EQ(ask(any, claim), "alert yes medium: x");
  EXPECT_EQ(ask(impostor, some), "alert yes medium: x");
  EXPECT_EQ(ask(any, some), "alert yes medium: x");
  EXPECT_EQ(ask(Call(Builtin::kFindingStands, Texts({"false_claim"})), some), "not known: 2");
}

TEST(UndecidableTest, RulesOfEverySectionMayAskForStandingFindings) {
  TestRules rules;
  const TypedExpr any = Call(Builtin::kFindingStands, Texts({"any"}));
  rules.Msg("message", any, {{Alert("x")}});
  rules.Graph("graph", any, {{Alert("y")}});
  TestRobot robot(rules);
  robot.state.findings = StandingFindings(/*told_all=*/true);
  EXPECT_EQ(robot.Message("/a").fired, 0u);
  robot.state.findings.Add("impostor");
  EXPECT_EQ(robot.Message("/a").fired, 1u);
  EXPECT_EQ(robot.Graph().fired, 1u);
}

TEST(UndecidableTest, TypesAreThoseOfTheMessage) {
  TestRules rules;
  rules.Msg("r", Call(Builtin::kMsgTypeIn, Texts({"std_msgs"})), {{Alert("x")}});
  TestRobot robot(rules);
  robot.state.graph_known = false;
  EXPECT_EQ(robot.Message("/a").fired, 1u);
}

// --- Actions for debugging, and the end of all rules.

TEST(DebugTest, TrueAndFalseShowValues) {
  TestRules rules;
  rules.Tick("r", B(true),
             {{Show(lang::ActionKind::kTrue, {I(1), F(0.5), B(false), S("x")}) >> kThen,
               Show(lang::ActionKind::kFalse, {}) >> kElse, Alert("reached")}});
  TestRobot robot(rules);
  EXPECT_THAT(Lines(robot.Tick(), robot.state),
              ElementsAre("log r: 1 0.5 false x", "log r: ", "alert r medium: reached"));
}

TEST(CrashTest, RaisesToTheLastLevelAndStopsEverything) {
  TestRules rules;
  rules.Tick("parked", Op(Name(Predefined::kCurrLevel), BinaryOp::kEq, L(0)),
             {{Exec({"p"}) >> kThen, Alert("after p")}});
  rules.Tick("r", B(true),
             {{Crash("boom") >> kElse, Alert("after crash")}, {Alert("another chain")}});
  rules.Tick("later", B(true), {{Alert("never")}});
  TestRobot robot(rules);
  const Outcome outcome = robot.Tick();
  EXPECT_THAT(Lines(outcome, robot.state),
              ElementsAre("run 1 parked: p", "level r A->D 1.2", "alert r critical: crash: boom"));
  EXPECT_TRUE(outcome.crashed);
  EXPECT_TRUE(robot.state.halted());
  EXPECT_THAT(Lines(robot.Tick(), robot.state), IsEmpty());
  EXPECT_THAT(Lines(OnProgramResult(1, true, robot.now, robot.state), robot.state), IsEmpty());
  robot.state.Resume();
  EXPECT_TRUE(robot.Tick().crashed);
}

TEST(CrashTest, AtTheLastLevelThereIsNothingToDecide) {
  TestRules rules;
  rules.Tick("r", B(true), {{Crash("boom")}});
  TestRobot robot(rules, 3);
  EXPECT_THAT(Lines(robot.Tick(), robot.state), ElementsAre("alert r critical: crash: boom"));
}

}  // namespace
}  // namespace rips::engine
