#include "policy_server/policy/engine/state/topic_cache.h"

#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/state/internal.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

TestGraph With(const std::string& publisher) {
  TestGraph graph;
  graph.Node(publisher).Publishes(publisher, "/a");
  return graph;
}

// One rule on each thing that is remembered.
TestRules Rules() {
  TestRules rules;
  rules.Msg("topic", Call(Builtin::kTopicIn, Texts({"/a"})), {{Alert("x")}});
  rules.Msg("type", Call(Builtin::kMsgTypeIn, Texts({"std_msgs"})), {{Alert("x")}});
  rules.Msg("facts", Call(Builtin::kPublishers, Texts({"/one"})), {{Alert("x")}});
  rules.Msg("graph", Call(Builtin::kNodesOnly, Texts({"/one"})), {{Alert("x")}});
  return rules;
}

// Names of one stream, with memos, and another one's without.
class TopicMemoTest : public testing::Test {
 protected:
  // Rules that fire on the message, the same with a memo and without.
  std::vector<std::string> Fires(const std::string& type) {
    std::vector<std::string> with = Judge(with_, type, &memo_);
    EXPECT_EQ(with, Judge(without_, type, nullptr));
    return with;
  }
  void SetGraph(const ros2::RosGraph& graph) {
    with_.state.graph = graph;
    without_.state.graph = graph;
  }

  static std::vector<std::string> Judge(TestRobot& robot, const std::string& type,
                                        TopicMemo* memo) {
    std::vector<std::string> rules;
    const Outcome outcome = robot.Judge(MessageEvent{.topic = "/a", .type = type, .memo = memo});
    for (const Effect& effect : outcome.effects) {
      rules.push_back(std::get<AlertEffect>(effect).rule);
    }
    return rules;
  }

  const std::string string_ = "std_msgs/msg/String";
  const std::string image_ = "sensor_msgs/msg/Image";
  TopicMemo memo_;
  TestRobot with_{Rules()};
  TestRobot without_{Rules()};
};

TEST_F(TopicMemoTest, ChangesNothing) {
  using ::testing::ElementsAre;
  EXPECT_THAT(Fires(string_), ElementsAre("topic", "type", "graph")) << "no graph, nobody";
  EXPECT_NE(memo_.entry, nullptr);
  EXPECT_THAT(Fires(string_), ElementsAre("topic", "type", "graph"));
  SetGraph(With("/one").Build());
  EXPECT_THAT(Fires(string_), ElementsAre("topic", "type", "facts", "graph"));
  SetGraph(With("/two").Build());
  EXPECT_THAT(Fires(string_), ElementsAre("topic", "type"));
  SetGraph(ros2::RosGraph());
  EXPECT_THAT(Fires(image_), ElementsAre("topic", "graph"));
  EXPECT_THAT(Fires(string_), ElementsAre("topic", "type", "graph"));
}

TEST_F(TopicMemoTest, IsForgottenWithTheRest) {
  Fires(string_);
  TestRules other;
  other.Msg("other", Call(Builtin::kTopicIn, Texts({"/a"})), {{Alert("x")}});
  const auto program = other.Build();
  ASSERT_THAT(with_.state.SwapProgram(program), IsOk());
  ASSERT_THAT(without_.state.SwapProgram(program), IsOk());
  EXPECT_THAT(Fires(string_), ::testing::ElementsAre("other"));
}

TEST_F(TopicMemoTest, OfAnotherRobotIsNotBelieved) {
  Fires(string_);
  TestRobot another{Rules()};
  another.state.graph = With("/one").Build();
  EXPECT_EQ(Judge(another, string_, &memo_).size(), 4u);
  EXPECT_EQ(Fires(string_).size(), 3u);
}

TEST_F(TopicMemoTest, SurvivesTooManyTopics) {
  Fires(string_);
  for (size_t i = 0; i < TopicCache::kTopicsMax + 10; ++i) {
    with_.Message(absl::StrCat("/made_up_", i));
    EXPECT_LE(with_.state.internal().topics.topics(), TopicCache::kTopicsMax);
  }
  EXPECT_EQ(Fires(string_).size(), 3u);
}

}  // namespace
}  // namespace rips::engine
