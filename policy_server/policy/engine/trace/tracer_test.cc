// What is recorded of a rule that fired: what each part of its condition was, and who made it true.
#include "policy_server/policy/engine/trace/tracer.h"

#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"
#include "policy_server/policy/lang/check/compile.h"

namespace rips::engine {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

std::shared_ptr<const CompiledPolicy> Compiled(const std::string& text) {
  const lang::CompileResult result = lang::Compile({{.path = "some/dir/r.rul", .text = text}});
  EXPECT_TRUE(result.rules.has_value())
      << lang::RenderText({{.path = "r.rul", .text = text}}, result.diagnostics);
  if (!result.rules.has_value()) return nullptr;
  auto program = CompiledPolicy::Create(*result.rules, {.bundle_id = "sha256:1"});
  EXPECT_THAT(program, IsOk());
  return program.ok() ? *program : nullptr;
}

// A rule of that section and condition that alerts and keeps every level in reach.
std::string Rules(const std::string& section, const std::string& condition) {
  return absl::StrCat("levels:\n  DEFAULT;\n  ALERT soft;\n  HALT;\nvars:\n  n int = 5;\n",
                      "rules ", section, ":\n  r: ", condition, " ? alert(\"seen\"), set(n, 9);\n",
                      "  other: false ? trigger(ALERT), trigger(HALT), set(n, n);\n");
}

Trace TraceIn(const Outcome& outcome) {
  for (const Effect& effect : outcome.effects) {
    if (const auto* alert = std::get_if<AlertEffect>(&effect)) return CopyOf(alert->trace);
    if (const auto* change = std::get_if<TransitionEffect>(&effect)) return CopyOf(change->trace);
  }
  return {};
}

// `SOURCE = VALUE`, indented by depth.
std::vector<std::string> Values(const Trace& trace) {
  std::vector<std::string> out;
  for (const TracedValue& value : trace.values) {
    out.push_back(absl::StrCat(std::string(value.depth, ' '),
                               trace.condition.substr(value.offset, value.length), " = ",
                               value.value));
  }
  return out;
}

// `NAME ROLE`.
std::vector<std::string> Who(const Trace& trace) {
  std::vector<std::string> out;
  for (const TracedSubject& subject : trace.subjects) {
    out.push_back(absl::StrCat(subject.name, " ", subject.role));
  }
  return out;
}

ros2::RosGraph Driven() {
  TestGraph graph;
  graph.Node("/nav").Node("/evil").Node("/cam");
  graph.Publishes("/nav", "/cmd_vel").Publishes("/evil", "/cmd_vel").Subscribes("/cam", "/cmd_vel");
  return graph.Build();
}

class TracerTest : public testing::Test {
 protected:
  Outcome OnGraph(const std::string& condition) {
    TestRobot robot(Compiled(Rules("Graph", condition)));
    robot.state.graph = Driven();
    return robot.Graph();
  }
  Outcome OnMessage(const std::string& condition, const std::string& sender = "/evil") {
    TestRobot robot(Compiled(Rules("Msg", condition)));
    robot.state.graph = Driven();
    return robot.Message("/cmd_vel", "geometry_msgs/msg/Twist", sender);
  }
};

TEST_F(TracerTest, SaysWhereTheRuleStandsWhatWasJudgedAndWhen) {
  const Trace trace = TraceIn(OnGraph("nodecount(3, 3)"));
  EXPECT_EQ(trace.place, "r.rul:8");
  EXPECT_EQ(trace.condition, "nodecount(3, 3)");
  EXPECT_EQ(trace.event, "graph change");
  EXPECT_EQ(trace.event_unix_ns, 1'700'000'000 * kNanosPerSecond);
  EXPECT_EQ(trace.bundle, "sha256:1");
  EXPECT_FALSE(trace.cut);
}

TEST_F(TracerTest, ShowsEachPartAsItWasAndWhatWasNotEvaluated) {
  EXPECT_THAT(Values(TraceIn(OnMessage(
                  "topicin(\"/cmd_vel\") && (n > 4 || payloadsize(1, 2)) && !senderin(\"/nav\")"))),
              ElementsAre("topicin(\"/cmd_vel\") = true", "n > 4 = true", " n = 5",
                          "payloadsize(1, 2) = not evaluated", "senderin(\"/nav\") = false"));
}

TEST_F(TracerTest, ShowsWhatCallsCompared) {
  EXPECT_THAT(Values(TraceIn(OnMessage("publishercount(2, 9) && !payloadsize(1, 9)"))),
              ElementsAre("publishercount(2, 9) = true: there are 2",
                          "payloadsize(1, 9) = false: 0 bytes"));
  EXPECT_THAT(Values(TraceIn(OnMessage("msgcount(1000, 1, 5)"))),
              ElementsAre("msgcount(1000, 1, 5) = true: 1"));
}

TEST_F(TracerTest, ShowsTextsAndLevels) {
  EXPECT_THAT(
      Values(TraceIn(OnMessage("Sender + \"x\" == \"/evilx\" && CurrLevel < HALT"))),
      ElementsAre("Sender + \"x\" == \"/evilx\" = true", " Sender + \"x\" = \"/evilx\"",
                  "  Sender = \"/evil\"", "CurrLevel < HALT = true", " CurrLevel = DEFAULT"));
}

// Before `set(n, 9)`, which stands before nothing that is traced.
TEST_F(TracerTest, IsOfBeforeTheRulesOwnEffects) {
  const std::string text =
      absl::StrCat("levels:\n  DEFAULT;\n  ALERT;\nvars:\n  n int = 5;\n",
                   "rules Graph:\n  r: n == 5 ? set(n, 9), alert(\"seen\"), trigger(ALERT);\n");
  TestRobot robot(Compiled(text));
  const Outcome outcome = robot.Graph();
  ASSERT_EQ(outcome.effects.size(), 2u);
  for (const Effect& effect : outcome.effects) {
    const auto* alert = std::get_if<AlertEffect>(&effect);
    const SharedTrace& trace =
        alert != nullptr ? alert->trace : std::get<TransitionEffect>(effect).trace;
    ASSERT_NE(trace, nullptr);
    EXPECT_THAT(Values(*trace), ElementsAre("n == 5 = true", " n = 5"));
  }
}

TEST_F(TracerTest, NamesWhoIsThereAndShouldNotBe) {
  EXPECT_THAT(Who(TraceIn(OnGraph("!topicpublishersonly(\"/cmd_vel\", \"/nav\")"))),
              ElementsAre("/evil publishes /cmd_vel"));
  EXPECT_THAT(Who(TraceIn(OnGraph("!nodesonly(\"/nav\", \"/cam\")"))),
              ElementsAre("/evil is a node"));
  EXPECT_THAT(Who(TraceIn(OnGraph("!topicsubscribers(\"/cmd_vel\", \"/rec\")"))),
              ElementsAre("/rec is not there", "/cam subscribes to /cmd_vel"));
}

TEST_F(TracerTest, NamesWhoIsCountedAndWhoIsAskedFor) {
  EXPECT_THAT(Who(TraceIn(OnGraph("topicpublishercount(\"/cmd_vel\", 2, 9)"))),
              ElementsAre("/nav publishes /cmd_vel", "/evil publishes /cmd_vel"));
  EXPECT_THAT(Who(TraceIn(OnGraph("hasnodes(\"evil\")"))), ElementsAre("/evil is a node"));
  EXPECT_THAT(Who(TraceIn(OnGraph("!hasnodes(\"guard\")"))), ElementsAre("guard is not there"));
}

TEST_F(TracerTest, NamesNobodyForAPartThatDidNotMakeItTrue) {
  EXPECT_THAT(Who(TraceIn(OnGraph("nodesonly(\"/nav\") || topiccount(1, 1)"))),
              ElementsAre("/cmd_vel is a topic"));
  EXPECT_THAT(Who(TraceIn(OnGraph("topicpublishersonly(\"/none\", \"/x\")"))), IsEmpty());
}

TEST_F(TracerTest, SaysWhoAMessageIsFromOnce) {
  EXPECT_THAT(Who(TraceIn(OnMessage("topicin(\"/cmd_vel\")"))),
              ElementsAre("/evil sent the message"));
  EXPECT_THAT(Who(TraceIn(OnMessage("topicin(\"/cmd_vel\")", ""))),
              ElementsAre("(not attributed) sent the message"));
}

TEST_F(TracerTest, SaysWhatAProcessSaysOfItself) {
  ros2::GraphDelta delta;
  const ros2::Guid guid{{1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1}};
  delta.upsert_participants.push_back(
      {.guid = guid, .host = "laptop", .pid = 4711, .address = "10.0.0.66"});
  delta.upsert_nodes.push_back({.full_name = "/evil", .participant = guid});
  ros2::RosGraph graph;
  ASSERT_THAT(graph.Apply(delta), IsOk());
  TestRobot robot(Compiled(Rules("Graph", "hasnodes(\"/evil\")")));
  robot.state.graph = std::move(graph);
  const Trace trace = TraceIn(robot.Graph());
  ASSERT_EQ(trace.subjects.size(), 1u);
  EXPECT_EQ(trace.subjects[0].guid, guid);
  EXPECT_EQ(trace.subjects[0].host, "laptop");
  EXPECT_EQ(trace.subjects[0].pid, 4711u);
  EXPECT_EQ(trace.subjects[0].address, "10.0.0.66");
}

TEST_F(TracerTest, SaysWhichFindingWasJudgedAndWhoItIsAbout) {
  TestRobot robot(Compiled(Rules("External", "finding(\"duplicate_node\")")));
  ros2::GraphDelta graph;
  for (const uint8_t number : {1, 2}) {
    const ros2::Guid guid{{1, 0x10, number, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1}};
    graph.upsert_participants.push_back({.guid = guid, .host = "h", .pid = number});
    graph.upsert_nodes.push_back({.full_name = "/arm", .participant = guid});
  }
  ros2::RosGraph shown;
  ASSERT_THAT(shown.Apply(graph), IsOk());
  robot.state.graph = shown;
  const model::Finding finding{.kind = "duplicate_node",
                               .guid = graph.upsert_participants[1].guid,
                               .node = "/arm",
                               .detail = "claimed by 2 participants"};
  const Trace trace = TraceIn(robot.Judge(ExternalEvent(finding)));
  EXPECT_EQ(trace.place, "r.rul:8");
  EXPECT_EQ(trace.finding.node, "/arm");
  EXPECT_EQ(trace.finding.guid, finding.guid);
  EXPECT_EQ(trace.finding.detail, "") << "it does not say which one it is";
  EXPECT_THAT(Who(trace), ElementsAre("/arm finding duplicate_node, is a node", "/arm is a node"));
  EXPECT_EQ(trace.subjects[0].pid, 2u);
  EXPECT_EQ(trace.subjects[1].pid, 1u);

  const Trace own = TraceFinding(finding, shown, 1);
  EXPECT_TRUE(own.none());
  EXPECT_TRUE(own.has_finding() && own.cut);
  EXPECT_THAT(own.subjects, SizeIs(1));
  EXPECT_FALSE(TraceIn(OnGraph("nodecount(3, 3)")).has_finding());
}

TEST_F(TracerTest, ATruncatedGraphIsSaidToBeSo) {
  TestGraph many;
  for (int i = 0; i < 20; ++i) many.Node(absl::StrCat("/n", i));
  TestRobot robot(Compiled(Rules("Graph", "nodecount(100, 200)")));
  robot.state.graph = many.Build({.nodes = 10});
  const Trace trace = TraceIn(robot.Graph());
  EXPECT_TRUE(trace.none()) << "at most 20 are there";
  TestRobot other(Compiled(Rules("Graph", "nodecount(15, 200)")));
  other.state.graph = many.Build({.nodes = 10});
  EXPECT_THAT(Values(TraceIn(other.Graph())),
              ElementsAre("nodecount(15, 200) = not known: the graph is truncated"));
}

TEST_F(TracerTest, IsBoundedWhateverTheRuleAndTheGraphHold) {
  TestGraph many;
  const std::string longest(200, 'x');
  for (int i = 0; i < 100; ++i) many.Node(absl::StrCat("/", longest, i));
  std::vector<std::string> parts(60, "nodecount(1, 1000)");
  parts.push_back("!nodesonly(\"/a\")");
  TestRobot robot(Compiled(Rules("Graph", absl::StrJoin(parts, " && "))));
  robot.state.graph = many.Build();
  const Trace trace = TraceIn(robot.Graph());
  EXPECT_TRUE(trace.cut);
  EXPECT_LE(trace.condition.size(), kConditionBytesMax);
  EXPECT_EQ(trace.values.size(), kTracedValuesMax);
  EXPECT_EQ(trace.subjects.size(), kSubjectsMax);
  for (const TracedSubject& subject : trace.subjects) {
    EXPECT_LE(subject.name.size(), kTracedTextBytesMax);
  }
}

TEST_F(TracerTest, ARuleThatOnlySetsIsNotTracedAndAFloodOfOneIsTracedSoOften) {
  TestRobot quiet(Compiled(
      "levels:\n  A;\n  B;\nvars:\n  n int = 0;\nrules Graph:\n  r: true ? set(n, n + 1);\n"
      "  o: n == 1000000 ? trigger(B);\n"));
  EXPECT_THAT(quiet.Graph().effects, IsEmpty());
  TestRobot robot(Compiled(Rules("Msg", "topicin(\"/t\")")));
  uint32_t traced = 0;
  for (int i = 0; i < 500; ++i) traced += TraceIn(robot.Message("/t")).none() ? 0 : 1;
  EXPECT_EQ(traced, 128u);
  robot.Advance(kNanosPerSecond);
  EXPECT_FALSE(TraceIn(robot.Message("/t")).none());
}

TEST_F(TracerTest, AChainThatWaitedHasTheTraceOfWhenItsRuleFired) {
  TestRobot robot(
      Compiled("levels:\n  A;\n  B;\nrules Msg:\n"
               "  r: topicin(\"/t\") ? exec(\"check\") => alert(\"late\"), trigger(B);\n"));
  const Outcome first = robot.Message("/t", "std_msgs/msg/String", "/talker");
  ASSERT_EQ(first.effects.size(), 1u);
  const uint64_t run = std::get<RunProgramEffect>(first.effects[0]).run_id;
  robot.Advance(kNanosPerSecond);
  const Outcome later = OnProgramResult(run, true, robot.now, robot.state);
  const Trace trace = TraceIn(later);
  EXPECT_EQ(trace.event, "message on /t from /talker");
  EXPECT_EQ(trace.event_unix_ns, robot.now.unix_ns - kNanosPerSecond);
}

TEST_F(TracerTest, CountsNoStep) {
  const auto steps = [](bool tells) {
    TestRules rules;
    const uint32_t n = rules.IntVar("n", 0);
    rules.Graph("r", Call(Builtin::kNodeCount, {I(0), I(9)}),
                {{tells ? Alert("x") : Set(n, I(0))}});
    return TestRobot(rules).Graph().steps;
  };
  EXPECT_EQ(steps(true), steps(false));
}

}  // namespace
}  // namespace rips::engine
