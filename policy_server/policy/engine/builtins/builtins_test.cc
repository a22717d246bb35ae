#include "policy_server/policy/engine/builtins/builtins.h"

#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/foresight.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

using lang::CheckedRules;

// Two publishers in one node, one name in two name spaces, a service twice.
TestGraph Robot() {
  TestGraph graph;
  graph.Node("/talker").Node("/left/camera").Node("/right/camera").Node("/nav");
  graph.Publishes("/talker", "/chatter").Publishes("/talker", "/chatter");
  graph.Publishes("/nav", "/cmd_vel", "geometry_msgs/msg/Twist");
  graph.Subscribes("/left/camera", "/chatter");
  graph.Serves("/nav", "/nav/stop").Serves("/nav", "/nav/go");
  graph.Serves("/left/camera", "/left/camera/on");
  return graph;
}

class BuiltinsTest : public testing::Test {
 protected:
  // The answer in a message rule on `topic`; fails on a fault.
  bool AskOn(Builtin builtin, Exprs args, const std::string& topic = "/chatter",
             const std::string& type = "std_msgs/msg/String") {
    TestRules rules;
    rules.rules.dialect = dialect_;
    rules.Msg("r", Call(builtin, std::move(args)), {{Alert("yes")}});
    TestRobot robot(rules);
    robot.state.graph = graph_;
    const Outcome outcome = robot.Message(topic, type);
    EXPECT_EQ(outcome.faults, 0u);
    return outcome.fired == 1;
  }
  bool Ask(Builtin builtin, const std::vector<std::string>& args) {
    return AskOn(builtin, Texts(args));
  }
  bool Count(Builtin builtin, int64_t min, int64_t max, std::vector<std::string> of = {}) {
    Exprs args = Texts(of);
    args.push_back(I(min));
    args.push_back(I(max));
    return AskOn(builtin, std::move(args));
  }

  ros2::RosGraph graph_ = Robot().Build();
  CheckedRules::Dialect dialect_ = CheckedRules::Dialect::kRips;
};

TEST_F(BuiltinsTest, TopicIn) {
  EXPECT_TRUE(Ask(Builtin::kTopicIn, {"/x", "/chatter", "/chatter"}));
  EXPECT_FALSE(Ask(Builtin::kTopicIn, {"chatter", "/chatter2"}));
  EXPECT_FALSE(Ask(Builtin::kTopicIn, {}));
}

TEST_F(BuiltinsTest, TopicInOfAnExpression) {
  EXPECT_TRUE(AskOn(Builtin::kTopicIn, Exprs{Concat(S("/chat"), S("ter"))}));
  EXPECT_FALSE(AskOn(Builtin::kTopicIn, Exprs{Concat(S("/chat"), S("er"))}));
}

TEST_F(BuiltinsTest, TopicMatchesSearches) {
  EXPECT_TRUE(Ask(Builtin::kTopicMatches, {"hat"}));
  EXPECT_TRUE(Ask(Builtin::kTopicMatches, {"^/chatter$"}));
  EXPECT_TRUE(Ask(Builtin::kTopicMatches, {""}));
  EXPECT_FALSE(Ask(Builtin::kTopicMatches, {"^chatter"}));
}

TEST_F(BuiltinsTest, MessageTypes) {
  EXPECT_TRUE(Ask(Builtin::kMsgTypeIn, {"geometry_msgs", "std_msgs"}));
  EXPECT_FALSE(Ask(Builtin::kMsgTypeIn, {"std_msg", "std_msgs/msg"}));
  EXPECT_TRUE(Ask(Builtin::kMsgSubtype, {"std_msgs", "String"}));
  EXPECT_FALSE(Ask(Builtin::kMsgSubtype, {"std_msgs", "Strin"}));
  EXPECT_FALSE(Ask(Builtin::kMsgSubtype, {"std", "String"}));
}

TEST_F(BuiltinsTest, ATopicHasTheTypesOfAllItsEndpoints) {
  graph_ = TestGraph()
               .Node("/a")
               .Publishes("/a", "/t", "one_msgs/msg/One")
               .Publishes("/a", "/t", "two_msgs/msg/Two")
               .Build();
  for (const char* sent : {"one_msgs/msg/One", "two_msgs/msg/Two", "three_msgs/msg/Three", ""}) {
    EXPECT_TRUE(AskOn(Builtin::kMsgTypeIn, Texts({"one_msgs"}), "/t", sent));
    EXPECT_TRUE(AskOn(Builtin::kMsgSubtype, Texts({"two_msgs", "Two"}), "/t", sent));
  }
  EXPECT_TRUE(AskOn(Builtin::kMsgTypeIn, Texts({"three_msgs"}), "/t", "three_msgs/msg/Three"));
  EXPECT_FALSE(AskOn(Builtin::kMsgTypeIn, Texts({"three_msgs"}), "/t", ""));
  EXPECT_FALSE(AskOn(Builtin::kMsgTypeIn, Texts({""}), "/unknown", "")) << "without a type";
}

TEST_F(BuiltinsTest, CountsEndpointsInclusively) {
  EXPECT_TRUE(Count(Builtin::kPublisherCount, 2, 2));
  EXPECT_TRUE(Count(Builtin::kPublisherCount, 0, 2));
  EXPECT_TRUE(Count(Builtin::kPublisherCount, 2, 9));
  EXPECT_FALSE(Count(Builtin::kPublisherCount, 0, 1));
  EXPECT_FALSE(Count(Builtin::kPublisherCount, 3, 9));
  EXPECT_FALSE(Count(Builtin::kPublisherCount, 9, 0));
  EXPECT_TRUE(Count(Builtin::kSubscriberCount, 1, 1));
  EXPECT_TRUE(Count(Builtin::kNodeCount, 4, 4));
  EXPECT_TRUE(Count(Builtin::kTopicCount, 2, 2));
  EXPECT_TRUE(Count(Builtin::kServiceCount, 2, 2, {"nav"}));
  EXPECT_TRUE(Count(Builtin::kServiceCount, 1, 1, {"camera"}));
  EXPECT_TRUE(Count(Builtin::kServiceCount, 0, 0, {"/right/camera"}));
  EXPECT_TRUE(Count(Builtin::kServiceCount, 0, 0, {"/unknown"}));
  EXPECT_TRUE(Count(Builtin::kTopicPublisherCount, 2, 2, {"/chatter"}));
  EXPECT_TRUE(Count(Builtin::kTopicPublisherCount, 0, 0, {"/unknown"}));
  EXPECT_TRUE(Count(Builtin::kTopicSubscriberCount, 1, 1, {"/chatter"}));
  EXPECT_TRUE(Count(Builtin::kTopicSubscriberCount, 0, 0, {"/cmd_vel"}));
}

TEST_F(BuiltinsTest, ExactlyThese) {
  EXPECT_TRUE(Ask(Builtin::kPublishers, {"/talker"}));
  EXPECT_TRUE(Ask(Builtin::kPublishers, {"talker", "talker"}));
  EXPECT_TRUE(Ask(Builtin::kPublishers, {"talker", "/talker"}));
  EXPECT_FALSE(Ask(Builtin::kPublishers, {"talker", "nav"}));
  EXPECT_FALSE(Ask(Builtin::kPublishers, {}));
  EXPECT_TRUE(Ask(Builtin::kSubscribers, {"camera"}));
  EXPECT_FALSE(Ask(Builtin::kSubscribers, {"/camera"}));
  EXPECT_TRUE(AskOn(Builtin::kSubscribers, Exprs{}, "/cmd_vel"));
  EXPECT_TRUE(AskOn(Builtin::kPublishers, Exprs{}, "/unknown"));
  EXPECT_TRUE(Ask(Builtin::kNodes, {"talker", "camera", "/nav"}));
  EXPECT_FALSE(Ask(Builtin::kNodes, {"talker", "/left/camera", "nav"}));
  EXPECT_FALSE(Ask(Builtin::kNodes, {"talker", "camera", "/nav", "ghost"}));
  EXPECT_TRUE(Ask(Builtin::kTopics, {"/cmd_vel", "/chatter"}));
  EXPECT_FALSE(Ask(Builtin::kTopics, {"/cmd_vel"}));
  EXPECT_FALSE(Ask(Builtin::kTopics, {"cmd_vel", "chatter"}));
  EXPECT_TRUE(Ask(Builtin::kServices, {"nav", "/nav/go", "/nav/stop"}));
  EXPECT_FALSE(Ask(Builtin::kServices, {"nav", "/nav/go"}));
  EXPECT_TRUE(Ask(Builtin::kServices, {"ghost"}));
  EXPECT_TRUE(Ask(Builtin::kTopicPublishers, {"/cmd_vel", "nav"}));
  EXPECT_FALSE(Ask(Builtin::kTopicPublishers, {"/cmd_vel", "nav", "talker"}));
  EXPECT_TRUE(Ask(Builtin::kTopicSubscribers, {"/cmd_vel"}));
  EXPECT_TRUE(Ask(Builtin::kTopicSubscribers, {"/chatter", "/left/camera"}));
}

TEST_F(BuiltinsTest, AnEmptyGraphHasExactlyNothing) {
  graph_ = ros2::RosGraph();
  EXPECT_TRUE(Ask(Builtin::kNodes, {}));
  EXPECT_TRUE(Ask(Builtin::kTopics, {}));
  EXPECT_FALSE(Ask(Builtin::kNodes, {"a"}));
  EXPECT_TRUE(Ask(Builtin::kNodesInclude, {}));
  EXPECT_TRUE(Count(Builtin::kNodeCount, 0, 0));
}

TEST_F(BuiltinsTest, ServiceOfANode) {
  EXPECT_TRUE(Ask(Builtin::kService, {"nav", "/nav/go"}));
  EXPECT_TRUE(Ask(Builtin::kService, {"camera", "/left/camera/on"}));
  EXPECT_FALSE(Ask(Builtin::kService, {"/right/camera", "/left/camera/on"}));
  EXPECT_FALSE(Ask(Builtin::kService, {"nav", "/nav/fly"}));
}

TEST_F(BuiltinsTest, GraphIncludeFormsAreAllowLists) {
  EXPECT_TRUE(Ask(Builtin::kNodesInclude, {"talker", "camera", "nav", "absent"}));
  EXPECT_FALSE(Ask(Builtin::kNodesInclude, {"talker", "nav"}));
  EXPECT_TRUE(Ask(Builtin::kTopicsInclude, {"/cmd_vel", "/chatter", "/absent"}));
  EXPECT_FALSE(Ask(Builtin::kTopicsInclude, {"/cmd_vel"}));
  EXPECT_TRUE(Ask(Builtin::kServicesInclude, {"nav", "/nav/go", "/nav/stop", "/absent"}));
  EXPECT_FALSE(Ask(Builtin::kServicesInclude, {"nav", "/nav/go"}));
  EXPECT_TRUE(Ask(Builtin::kTopicPublishersInclude, {"/cmd_vel", "nav", "absent"}));
  EXPECT_FALSE(Ask(Builtin::kTopicPublishersInclude, {"/cmd_vel", "talker"}));
  EXPECT_TRUE(Ask(Builtin::kTopicSubscribersInclude, {"/chatter", "camera", "absent"}));
  EXPECT_FALSE(Ask(Builtin::kTopicSubscribersInclude, {"/chatter"}));
}

TEST_F(BuiltinsTest, MessageIncludeFormsAskForTheGiven) {
  EXPECT_TRUE(Ask(Builtin::kPublishersInclude, {"talker"}));
  EXPECT_TRUE(Ask(Builtin::kPublishersInclude, {}));
  EXPECT_FALSE(Ask(Builtin::kPublishersInclude, {"talker", "nav"}));
  EXPECT_TRUE(Ask(Builtin::kSubscribersInclude, {"camera"}));
  EXPECT_TRUE(Ask(Builtin::kSubscribersInclude, {}));
  EXPECT_FALSE(Ask(Builtin::kSubscribersInclude, {"camera", "nav"}));
}

TEST_F(BuiltinsTest, ThePrototypesIncludeFormsAreTheConverse) {
  dialect_ = CheckedRules::Dialect::kPrototype;
  EXPECT_FALSE(Ask(Builtin::kNodesInclude, {"talker", "camera", "nav", "absent"}));
  EXPECT_TRUE(Ask(Builtin::kNodesInclude, {"talker", "nav"}));
  EXPECT_TRUE(Ask(Builtin::kNodesInclude, {}));
  EXPECT_TRUE(Ask(Builtin::kTopicsInclude, {"/cmd_vel"}));
  EXPECT_FALSE(Ask(Builtin::kTopicsInclude, {"/cmd_vel", "/absent"}));
  EXPECT_TRUE(Ask(Builtin::kServicesInclude, {"nav", "/nav/go"}));
  EXPECT_FALSE(Ask(Builtin::kServicesInclude, {"nav", "/absent"}));
  EXPECT_TRUE(Ask(Builtin::kTopicPublishersInclude, {"/cmd_vel"}));
  EXPECT_FALSE(Ask(Builtin::kTopicPublishersInclude, {"/cmd_vel", "nav", "absent"}));
  EXPECT_FALSE(Ask(Builtin::kTopicSubscribersInclude, {"/chatter", "camera", "absent"}));
  // The one of messages that stays, and the one that is inverted.
  EXPECT_TRUE(Ask(Builtin::kPublishersInclude, {}));
  EXPECT_FALSE(Ask(Builtin::kPublishersInclude, {"talker", "nav"}));
  EXPECT_TRUE(Ask(Builtin::kSubscribersInclude, {"camera", "nav"}));
  EXPECT_FALSE(Ask(Builtin::kSubscribersInclude, {}));
}

TEST_F(BuiltinsTest, AnUnattributedPublisherIsNoneOfTheGiven) {
  graph_ = Robot()
               .Endpoint(ros2::EndpointKind::kPublisher, "", "/chatter", "std_msgs/msg/String")
               .Build();
  const std::vector<std::string>& publishers = graph_.FindTopic("/chatter")->publishers;
  ASSERT_EQ(publishers.size(), 3u);

  EXPECT_TRUE(Count(Builtin::kPublisherCount, 3, 3));
  EXPECT_FALSE(Ask(Builtin::kPublishers, {"talker"}));
  EXPECT_FALSE(Ask(Builtin::kTopicPublishersInclude, {"/chatter", "talker"}));
  EXPECT_TRUE(Ask(Builtin::kPublishersInclude, {"talker"}));
  // Not even by the text it stands under.
  for (const std::string& publisher : publishers) {
    if (publisher[0] == '/') continue;
    EXPECT_FALSE(Ask(Builtin::kPublishers, {"talker", publisher}));
    EXPECT_FALSE(Ask(Builtin::kPublishersInclude, {publisher}));
  }
}

TEST_F(BuiltinsTest, ATruncatedGraphNeverSaysNothingElse) {
  graph_ = Robot().Build({.nodes = 4, .endpoints = 6});
  ASSERT_TRUE(graph_.truncated());

  EXPECT_FALSE(Ask(Builtin::kNodes, {"talker", "camera", "nav"}));
  EXPECT_FALSE(Ask(Builtin::kTopics, {"/chatter", "/cmd_vel"}));
  EXPECT_FALSE(Ask(Builtin::kTopicPublishers, {"/cmd_vel", "nav"}));
  EXPECT_FALSE(Ask(Builtin::kPublishers, {"talker"}));
  EXPECT_FALSE(Ask(Builtin::kServices, {"ghost"}));
  EXPECT_TRUE(Ask(Builtin::kPublishersInclude, {"talker"}));
}

// A rule whose value depends on what was left out fires, and so does its opposite: an attacker who
// fills the graph does not hide behind it. Each row of LeftOpen's table, straight and negated.
class TruncatedGraphTest : public testing::Test {
 protected:
  // T and F are decided; open = the rule and its negation both fire, unscanned.
  enum Answer { kF, kT, kOpen };

  TruncatedGraphTest() { LeaveOut(1); }

  // Of what is in Robot(), everything, and `count` more are missing.
  void LeaveOut(uint64_t count) {
    graph_ = Robot().Build();
    ASSERT_TRUE(graph_.Apply({.truncation = ros2::Truncation{.left_out = count}}).ok());
  }
  Outcome Judge(TypedExpr condition, CompiledPolicyOptions options = {}) {
    TestRules rules;
    rules.Msg("r", std::move(condition), {{Alert("yes")}});
    TestRobot robot(rules.Build(options));
    robot.state.graph = graph_;
    return robot.Message("/chatter", "std_msgs/msg/String");
  }
  Answer Of(Builtin builtin, const Exprs& args) {
    const Outcome yes = Judge(Call(builtin, args));
    const Outcome no = Judge(Not(Call(builtin, args)));
    EXPECT_TRUE(yes.fired + no.fired >= 1);
    EXPECT_EQ(yes.unscanned, no.unscanned);
    EXPECT_EQ(yes.unscanned == 1, yes.fired + no.fired == 2);
    return yes.unscanned == 1 ? kOpen : yes.fired == 1 ? kT : kF;
  }
  Answer Names(Builtin builtin, const std::vector<std::string>& texts) {
    return Of(builtin, Texts(texts));
  }
  Answer Range(Builtin builtin, int64_t min, int64_t max, const std::vector<std::string>& of = {}) {
    Exprs args = Texts(of);
    args.push_back(I(min));
    args.push_back(I(max));
    return Of(builtin, args);
  }

  ros2::RosGraph graph_;
};

TEST_F(TruncatedGraphTest, ExactlyTheseIsFalseAndItsNegationTrue) {
  EXPECT_EQ(Names(Builtin::kNodes, {"talker", "camera", "nav"}), kF);
  EXPECT_EQ(Names(Builtin::kTopics, {"/chatter", "/cmd_vel"}), kF);
  EXPECT_EQ(Names(Builtin::kPublishers, {"talker"}), kF);
  EXPECT_EQ(Names(Builtin::kSubscribers, {"camera"}), kF);
  EXPECT_EQ(Names(Builtin::kServices, {"nav", "/nav/go", "/nav/stop"}), kF);
  EXPECT_EQ(Names(Builtin::kTopicPublishers, {"/cmd_vel", "nav"}), kF);
  EXPECT_EQ(Names(Builtin::kTopicSubscribers, {"/cmd_vel"}), kF);
}

TEST_F(TruncatedGraphTest, CurrentInGivenIsFalseIfAnotherNodeIsThereElseOpen) {
  const std::vector<std::pair<Builtin, std::vector<std::string>>> all = {
      {Builtin::kNodesInclude, {"talker", "camera", "nav"}},
      {Builtin::kNodesOnly, {"talker", "camera", "nav"}},
      {Builtin::kTopicsInclude, {"/cmd_vel", "/chatter"}},
      {Builtin::kTopicsOnly, {"/cmd_vel", "/chatter"}},
      {Builtin::kServicesInclude, {"nav", "/nav/go", "/nav/stop"}},
      {Builtin::kServicesOnly, {"nav", "/nav/go", "/nav/stop"}},
      {Builtin::kTopicPublishersInclude, {"/cmd_vel", "nav"}},
      {Builtin::kTopicPublishersOnly, {"/cmd_vel", "nav"}},
      {Builtin::kTopicSubscribersInclude, {"/chatter", "camera"}},
      {Builtin::kTopicSubscribersOnly, {"/chatter", "camera"}}};
  for (const auto& [builtin, names] : all) {
    EXPECT_EQ(Names(builtin, names), kOpen) << static_cast<int>(builtin);
    std::vector<std::string> too_few = names;
    too_few.pop_back();
    EXPECT_EQ(Names(builtin, too_few), kF) << static_cast<int>(builtin);
  }
  EXPECT_EQ(Names(Builtin::kServicesOnly, {"ghost"}), kOpen);
}

TEST_F(TruncatedGraphTest, GivenInCurrentIsTrueIfAllAreThereElseOpen) {
  const std::vector<std::pair<Builtin, std::vector<std::string>>> all = {
      {Builtin::kHasNodes, {"talker"}},
      {Builtin::kHasTopics, {"/chatter"}},
      {Builtin::kHasServices, {"nav", "/nav/go"}},
      {Builtin::kHasTopicPublishers, {"/cmd_vel", "nav"}},
      {Builtin::kHasTopicSubscribers, {"/chatter", "camera"}},
      {Builtin::kPublishersInclude, {"talker"}},
      {Builtin::kSubscribersInclude, {"camera"}}};
  for (const auto& [builtin, names] : all) {
    EXPECT_EQ(Names(builtin, names), kT) << static_cast<int>(builtin);
    std::vector<std::string> more = names;
    more.push_back("/ghost");
    EXPECT_EQ(Names(builtin, more), kOpen) << static_cast<int>(builtin);
  }
  EXPECT_EQ(Names(Builtin::kService, {"nav", "/nav/go"}), kT);
  EXPECT_EQ(Names(Builtin::kService, {"nav", "/nav/fly"}), kOpen);
  EXPECT_EQ(Names(Builtin::kService, {"ghost", "/x"}), kOpen);
}

TEST_F(TruncatedGraphTest, CountsAreDecidedAsFarAsTheMissingCannotTurnThem) {
  struct Count {
    Builtin builtin;
    std::vector<std::string> of;
    int64_t n;
  };
  const std::vector<Count> all = {{Builtin::kPublisherCount, {}, 2},
                                  {Builtin::kSubscriberCount, {}, 1},
                                  {Builtin::kNodeCount, {}, 4},
                                  {Builtin::kTopicCount, {}, 2},
                                  {Builtin::kServiceCount, {"nav"}, 2},
                                  {Builtin::kServiceCount, {"ghost"}, 0},
                                  {Builtin::kTopicPublisherCount, {"/chatter"}, 2},
                                  {Builtin::kTopicPublisherCount, {"/ghost"}, 0},
                                  {Builtin::kTopicSubscriberCount, {"/chatter"}, 1}};
  for (const int64_t left_out : {1, 10}) {
    LeaveOut(static_cast<uint64_t>(left_out));
    for (const auto& [builtin, of, n] : all) {
      SCOPED_TRACE(absl::StrCat(static_cast<int>(builtin), " with ", left_out, " left out"));
      EXPECT_EQ(Range(builtin, 0, n - 1, of), kF) << "more are there already";
      EXPECT_EQ(Range(builtin, n, n, of), kOpen);
      EXPECT_EQ(Range(builtin, n + 1, n + 1, of), kOpen);
      EXPECT_EQ(Range(builtin, n, n + left_out - 1, of), kOpen);
      EXPECT_EQ(Range(builtin, n, n + left_out, of), kT) << "enough for all that are missing";
      EXPECT_EQ(Range(builtin, n + 1, 1'000'000, of), kOpen);
      EXPECT_EQ(Range(builtin, n + left_out, 1'000'000, of), kOpen);
      EXPECT_EQ(Range(builtin, n + left_out + 1, 1'000'000, of), kF) << "not even with them";
      EXPECT_EQ(Range(builtin, 9, 0, of), kF) << "no number is in this range";
    }
  }
  // A sensor that says more than fits.
  LeaveOut(~uint64_t{0});
  EXPECT_EQ(Range(Builtin::kNodeCount, 4, INT64_MAX), kT);
  EXPECT_EQ(Range(Builtin::kNodeCount, 4, INT64_MAX - 1), kOpen);
}

TEST_F(TruncatedGraphTest, WhatAsksOfTheMessageIsAsEver) {
  EXPECT_EQ(Names(Builtin::kTopicIn, {"/chatter"}), kT);
  EXPECT_EQ(Names(Builtin::kTopicIn, {"/ghost"}), kF);
  EXPECT_EQ(Names(Builtin::kMsgTypeIn, {"geometry_msgs"}), kF);
  EXPECT_EQ(Names(Builtin::kMsgSubtype, {"std_msgs", "String"}), kT);
}

TEST_F(TruncatedGraphTest, TheNodeOfAWriterThatWasLeftOutIsOpen) {
  const auto of = [&](Builtin builtin, const std::string& name, const ros2::Guid& writer,
                      const std::string& sender) {
    const auto judge = [&](TypedExpr condition) {
      TestRules rules;
      rules.Msg("r", std::move(condition), {{Alert("yes")}});
      TestRobot robot(rules);
      robot.state.graph = graph_;
      return robot.Judge(
          MessageEvent{.topic = "/chatter", .type = "t/msg/T", .writer = writer, .sender = sender});
    };
    const Outcome yes = judge(Call(builtin, Texts({name})));
    EXPECT_EQ(judge(Not(Call(builtin, Texts({name})))).unscanned, yes.unscanned);
    return yes.unscanned == 1 ? kOpen : yes.fired == 1 ? kT : kF;
  };
  const ros2::Guid shown = graph_.endpoints().begin()->first;
  ros2::Guid unlisted = shown;
  unlisted.bytes[5] = 77;
  EXPECT_EQ(of(Builtin::kSenderIn, "/evil", unlisted, ""), kOpen);
  EXPECT_EQ(of(Builtin::kSenderIn, "/evil", unlisted, "/evil"), kT);
  EXPECT_EQ(of(Builtin::kSenderIn, "/evil", unlisted, "/good"), kF);
  EXPECT_EQ(of(Builtin::kSenderEnclave, "/evil", unlisted, ""), kOpen);
  EXPECT_EQ(of(Builtin::kSenderEnclave, "/evil", shown, ""), kF);
  graph_ = Robot().Build();
  EXPECT_EQ(of(Builtin::kSenderIn, "/evil", unlisted, ""), kF);
  EXPECT_EQ(of(Builtin::kSenderEnclave, "/evil", unlisted, ""), kF);
}

TEST_F(TruncatedGraphTest, ArgumentsThatAreNotConstantAreAskedAlike) {
  EXPECT_EQ(Of(Builtin::kHasNodes, {Concat(Name(Predefined::kRobot), S("ghost"))}), kOpen);
}

TEST_F(TruncatedGraphTest, AGraphThatWasCutHereIsTruncatedToo) {
  graph_ = Robot().Build({.nodes = 4, .endpoints = 6});
  ASSERT_TRUE(graph_.truncated());
  EXPECT_EQ(Range(Builtin::kNodeCount, 4, 4), kOpen);
  EXPECT_EQ(Range(Builtin::kNodeCount, 0, 3), kF);
}

TEST_F(TruncatedGraphTest, TheBundleDecidesWhetherItFires) {
  const auto open = [&] { return Call(Builtin::kHasNodes, Texts({"ghost"})); };
  const Outcome match = Judge(open());
  ASSERT_EQ(match.effects.size(), 1u);
  EXPECT_TRUE(std::get<AlertEffect>(match.effects[0]).graph_truncated);

  const Outcome ignored = Judge(open(), {.on_inspection_error = OnInspectionError::kIgnore});
  EXPECT_EQ(ignored.fired, 0u);
  EXPECT_EQ(ignored.unscanned, 1u);
  EXPECT_THAT(ignored.effects, testing::IsEmpty());

  const Outcome alerted = Judge(open(), {.on_inspection_error = OnInspectionError::kAlert});
  EXPECT_EQ(alerted.fired, 0u);
  ASSERT_EQ(alerted.effects.size(), 1u);
  EXPECT_THAT(std::get<AlertEffect>(alerted.effects[0]).text,
              testing::HasSubstr("graph truncated"));

  // Decided rules say nothing of it.
  const Outcome decided = Judge(Call(Builtin::kHasNodes, Texts({"talker"})));
  EXPECT_FALSE(std::get<AlertEffect>(decided.effects[0]).graph_truncated);
}

TEST_F(TruncatedGraphTest, WhatWouldRaiseCountsAnOpenRule) {
  TestRules rules;
  rules.Graph("count", Call(Builtin::kTopicPublisherCount, Exprs{S("/cmd_vel"), I(2), I(100)}),
              {{Trigger(1)}});
  TestRobot robot(rules);
  robot.state.graph = Robot().Build();
  EXPECT_THAT(WouldRaise(0, robot.now, robot.state), testing::IsEmpty());
  robot.state.graph = graph_;
  EXPECT_THAT(WouldRaise(0, robot.now, robot.state), testing::ElementsAre("count"));
}

TEST_F(BuiltinsTest, AWholeGraphLeavesNothingOpen) {
  ASSERT_FALSE(graph_.truncated());
  EXPECT_FALSE(Ask(Builtin::kHasNodes, {"ghost"}));
  EXPECT_FALSE(Count(Builtin::kNodeCount, 5, 9));
}

TEST_F(BuiltinsTest, TwoNodesOfOneNameCountAsTwo) {
  graph_ = TestGraph().Node("/a").Node("/a").Build();
  EXPECT_TRUE(Count(Builtin::kNodeCount, 2, 2));
  EXPECT_TRUE(Ask(Builtin::kNodes, {"/a"}));
}

TEST_F(BuiltinsTest, ManyNamesAreASetToo) {
  TestGraph graph;
  std::vector<std::string> names;
  for (int i = 0; i < 100; ++i) {
    graph.Node(absl::StrCat("/ns/n", i));
    names.push_back(absl::StrCat(i % 2 == 0 ? "/ns/n" : "n", i));
  }
  graph_ = graph.Build();

  EXPECT_TRUE(Ask(Builtin::kNodes, names));
  names.pop_back();
  EXPECT_FALSE(Ask(Builtin::kNodesInclude, names));
}

}  // namespace
}  // namespace rips::engine
