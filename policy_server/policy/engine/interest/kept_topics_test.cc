#include "policy_server/policy/engine/interest/kept_topics.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

using ::testing::SizeIs;
using ::testing::UnorderedElementsAre;

ros2::TopicNames Of(const TestRules& rules) { return KeptTopics(rules.rules); }

TEST(KeptTopicsTest, AreThoseThatRulesName) {
  TestRules rules;
  rules.Msg(
      "in",
      And(Call(Builtin::kTopicIn, Texts({"/a", "/b"})), Call(Builtin::kSenderIn, Texts({"/node"}))),
      {{Alert("x")}});
  rules.Graph("count", Not(Call(Builtin::kTopicPublisherCount, Exprs{S("/cmd_vel"), I(0), I(1)})),
              {{Alert("x")}});
  rules.Graph("who", Call(Builtin::kTopicPublishers, Texts({"/scan", "/lidar"})), {{Alert("x")}});
  rules.Graph("all", Call(Builtin::kHasTopics, Texts({"/e", "/f"})), {{Alert("x")}});
  rules.Graph("nodes", Call(Builtin::kNodes, Texts({"/g"})), {{Alert("x")}});
  EXPECT_THAT(Of(rules), UnorderedElementsAre("/a", "/b", "/cmd_vel", "/scan", "/e", "/f"));
}

TEST(KeptTopicsTest, PatternsAndWhatIsPutTogetherAreNone) {
  TestRules rules;
  rules.Msg("pattern", Call(Builtin::kTopicMatches, Texts({"/a"})), {{Alert("x")}});
  rules.Msg("joined", Call(Builtin::kTopicIn, Exprs{Concat(Name(Predefined::kRobot), S("/b"))}),
            {{Alert("x")}});
  rules.Msg("bad name", Call(Builtin::kTopicIn, Texts({"c", "", "/d//"})), {{Alert("x")}});
  EXPECT_THAT(Of(rules), SizeIs(0));
}

TEST(KeptTopicsTest, AreNoMoreThanTheLimit) {
  TestRules rules;
  for (size_t i = 0; i < ros2::kKeptTopicsMax + 10; ++i) {
    rules.Msg(absl::StrCat("r", i), Call(Builtin::kTopicIn, Texts({absl::StrCat("/t", i)})),
              {{Alert("x")}});
  }
  const ros2::TopicNames names = Of(rules);
  EXPECT_THAT(names, SizeIs(ros2::kKeptTopicsMax));
  EXPECT_TRUE(names.contains("/t0")) << "the first are kept";
}

}  // namespace
}  // namespace rips::engine
