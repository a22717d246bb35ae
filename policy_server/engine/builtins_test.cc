#include "policy_server/engine/builtins.h"

#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/engine/test_rules.h"

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
// fills the graph does not hide behind it.
TEST_F(BuiltinsTest, WhatATruncatedGraphLeavesOpenFiresBothWays) {
  graph_ = Robot().Build({.nodes = 4, .endpoints = 6});
  ASSERT_TRUE(graph_.truncated());
  enum { kTrue, kFalse, kOpen };
  const auto answer = [&](Builtin builtin, const Exprs& args) {
    const bool yes = AskOn(builtin, args);
    TestRules rules;
    rules.Msg("r", Not(Call(builtin, args)), {{Alert("no")}});
    TestRobot robot(rules);
    robot.state.graph = graph_;
    const bool no = robot.Message("/chatter", "std_msgs/msg/String").fired == 1;
    EXPECT_TRUE(yes || no);
    return yes && no ? kOpen : yes ? kTrue : kFalse;
  };
  const auto names = [&](Builtin builtin, const std::vector<std::string>& texts) {
    return answer(builtin, Texts(texts));
  };
  const auto range = [&](Builtin builtin, int64_t min, int64_t max,
                         const std::vector<std::string>& of = {}) {
    Exprs args = Texts(of);
    args.push_back(I(min));
    args.push_back(I(max));
    return answer(builtin, args);
  };
  EXPECT_EQ(names(Builtin::kNodes, {"talker", "camera", "nav"}), kFalse);
  // Current in given.
  EXPECT_EQ(names(Builtin::kNodesInclude, {"talker", "camera", "nav"}), kOpen);
  EXPECT_EQ(names(Builtin::kNodesInclude, {"talker", "camera"}), kFalse);
  EXPECT_EQ(names(Builtin::kTopicPublishersInclude, {"/cmd_vel", "nav"}), kOpen);
  EXPECT_EQ(names(Builtin::kTopicPublishersInclude, {"/cmd_vel", "other"}), kFalse);
  EXPECT_EQ(names(Builtin::kTopicsOnly, {"/chatter", "/cmd_vel"}), kOpen);
  EXPECT_EQ(names(Builtin::kServicesOnly, {"ghost"}), kOpen);
  // Given in current.
  EXPECT_EQ(names(Builtin::kHasNodes, {"talker"}), kTrue);
  EXPECT_EQ(names(Builtin::kHasNodes, {"ghost"}), kOpen);
  EXPECT_EQ(names(Builtin::kPublishersInclude, {"talker"}), kTrue);
  EXPECT_EQ(names(Builtin::kPublishersInclude, {"ghost"}), kOpen);
  EXPECT_EQ(names(Builtin::kService, {"ghost", "/x"}), kOpen);
  // Counts: there may be more, and are not fewer.
  EXPECT_EQ(range(Builtin::kNodeCount, 4, 4), kOpen);
  EXPECT_EQ(range(Builtin::kNodeCount, 0, 3), kFalse);
  EXPECT_EQ(range(Builtin::kNodeCount, 5, 9), kOpen);
  EXPECT_EQ(range(Builtin::kPublisherCount, 2, 2), kOpen);
  EXPECT_EQ(range(Builtin::kTopicPublisherCount, 0, 1, {"/chatter"}), kFalse);
  EXPECT_EQ(range(Builtin::kServiceCount, 1, 2, {"ghost"}), kOpen);
  // What does not ask the graph is as ever.
  EXPECT_EQ(names(Builtin::kTopicIn, {"/chatter"}), kTrue);
  EXPECT_EQ(names(Builtin::kMsgTypeIn, {"geometry_msgs"}), kFalse);
  // Arguments that are not constant, which nobody remembers the answer of.
  EXPECT_EQ(answer(Builtin::kHasNodes, {Concat(Name(Predefined::kRobot), S("ghost"))}), kOpen);
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
