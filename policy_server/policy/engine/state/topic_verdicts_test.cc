#include "policy_server/policy/engine/state/topic_verdicts.h"

#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;

TypedExpr Topic(const std::string& topic) { return Call(Builtin::kTopicIn, Texts({topic})); }
TypedExpr Unknown() { return Call(Builtin::kPublisherCount, {I(1), I(1)}); }

class TopicVerdictsTest : public testing::Test {
 protected:
  const TopicVerdict& For(const std::string& topic, std::vector<absl::string_view> types = {}) {
    types_ = std::move(types);
    return verdicts_.For(*program_, {.graph = graph_, .topic = topic, .types = types_});
  }

  ros2::RosGraph graph_;
  std::vector<absl::string_view> types_;
  std::shared_ptr<const CompiledPolicy> program_;
  TopicVerdicts verdicts_;
};

TEST_F(TopicVerdictsTest, LeavesOutRulesThatCannotApply) {
  TestRules rules;
  const std::vector<TypedChain> chains = {{Alert("x")}};
  rules.Msg("0", Topic("/a"), chains);
  rules.Msg("1", And(Unknown(), Topic("/a")), chains);
  rules.Msg("2", And(Topic("/a"), Faulty()), chains);
  rules.Msg("3", And(Faulty(), Topic("/a")), chains);  // its fault must be seen
  rules.Msg("4", Or(Topic("/a"), Unknown()), chains);
  rules.Msg("5", Not(Topic("/a")), chains);
  rules.Msg("6", And(Not(Or(Topic("/a"), Topic("/b"))), Unknown()), chains);
  rules.Msg("7", B(false), chains);
  rules.Msg("8", And(Unknown(), And(Unknown(), B(false))), chains);
  rules.Msg("9", Op(Topic("/a"), BinaryOp::kEq, B(false)), chains);
  program_ = rules.Build();

  EXPECT_THAT(For("/a").rules, ElementsAre(0, 1, 2, 3, 4, 9));
  EXPECT_THAT(For("/b").rules, ElementsAre(3, 4, 5, 9));
  EXPECT_THAT(For("/c").rules, ElementsAre(3, 4, 5, 6, 9));
  EXPECT_EQ(program_->compiled().predicates.size(), 2u) << "equal calls share one";
}

TEST_F(TopicVerdictsTest, DecidesAnewWhenTheTypesChange) {
  TestRules rules;
  rules.Msg("r", Call(Builtin::kMsgTypeIn, Texts({"std_msgs"})), {{Alert("x")}});
  program_ = rules.Build();

  EXPECT_THAT(For("/t", {"std_msgs/msg/String"}).rules, ElementsAre(0));
  EXPECT_THAT(For("/t", {"x/msg/X"}).rules, IsEmpty());
  EXPECT_THAT(For("/t", {"x/msg/X", "std_msgs/msg/String"}).rules, ElementsAre(0));
  EXPECT_THAT(For("/t").rules, IsEmpty());
  EXPECT_EQ(verdicts_.topics(), 1u);
}

TEST_F(TopicVerdictsTest, TopicsThatAnswerAlikeShareAVerdict) {
  TestRules rules;
  rules.Msg("r", Topic("/a"), {{Alert("x")}});
  program_ = rules.Build();
  for (int i = 0; i < 1'000; ++i) For(absl::StrCat("/made_up_", i));
  For("/a");

  EXPECT_EQ(verdicts_.topics(), 1'001u);
  EXPECT_EQ(verdicts_.verdicts(), 2u);
}

TEST_F(TopicVerdictsTest, ForgetsAllPastTheLimitAndStaysRight) {
  TestRules rules;
  rules.Msg("r", Topic("/a"), {{Alert("x")}});
  program_ = rules.Build();
  for (int i = 0; i < 10'000; ++i) {
    EXPECT_THAT(For(absl::StrCat("/made_up_", i)).rules, IsEmpty());
    EXPECT_LE(verdicts_.topics(), TopicVerdicts::kTopicsMax);
    if (i % 1000 == 0) {
      EXPECT_THAT(For("/a").rules, ElementsAre(0));
    }
  }
}

TEST_F(TopicVerdictsTest, BoundsTheRulesItRemembers) {
  TestRules rules;
  // Rule k applies to topics whose name holds digit k; every topic is about another set of them.
  for (int bit = 0; bit < 12; ++bit) {
    rules.Msg("b", Call(Builtin::kTopicMatches, Texts({absl::StrCat("_", bit, "_")})),
              {{Alert("x")}});
  }
  for (int i = 0; i < 3'000; ++i) rules.Msg("all", Unknown(), {{Alert("x")}});
  program_ = rules.Build();

  for (int set = 0; set < 1'000; ++set) {
    std::string topic = "/";
    for (int bit = 0; bit < 12; ++bit) {
      if ((set >> bit & 1) != 0) absl::StrAppend(&topic, "_", bit, "_");
    }
    ASSERT_GE(For(topic).rules.size(), 3'000u);
    ASSERT_LE(verdicts_.verdicts(), TopicVerdicts::kRulesMax / 3'000 + 1);
  }
}

TEST_F(TopicVerdictsTest, DoesNotRememberLongNamesOrManyTypes) {
  TestRules rules;
  rules.Msg("r", Call(Builtin::kTopicMatches, Texts({"b$"})), {{Alert("x")}});
  program_ = rules.Build();
  const std::string long_name = "/" + std::string(TopicVerdicts::kNameBytesMax, 'a');

  EXPECT_THAT(For(long_name + "b").rules, ElementsAre(0));
  EXPECT_THAT(For(long_name).rules, IsEmpty());
  EXPECT_THAT(For("/b", {long_name}).rules, ElementsAre(0));
  EXPECT_THAT(For("/b", std::vector<absl::string_view>(TopicVerdicts::kTypesMax + 1, "t")).rules,
              ElementsAre(0));
  EXPECT_EQ(verdicts_.topics(), 0u);
}

TEST_F(TopicVerdictsTest, AFaultBeforeATopicIsStillSeen) {
  TestRules rules;
  rules.Msg("r", And(Faulty(), Topic("/a")), {{Alert("x")}});
  TestRobot robot(rules);

  EXPECT_EQ(robot.Message("/elsewhere").faults, 1u);
}

}  // namespace
}  // namespace rips::engine
