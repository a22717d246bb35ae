// Messages that were lost count, so that a flood cannot hide by being shed.
#include <string>
#include <utility>

#include "gmock/gmock.h"
#include "policy_server/policy/engine/state/internal.h"
#include "policy_server/policy/engine/test_rules.h"

namespace rips::engine {
namespace {

constexpr char kType[] = "std_msgs/msg/String";

ros2::Guid Writer(uint8_t n) {
  ros2::Guid guid;
  guid.bytes[0] = n;
  return guid;
}

// `by_topic` fires with ten messages of a topic within a second, `by_sender` with ten of a writer.
class MessageCountsTest : public testing::Test {
 protected:
  static TestRules Rules(TypedExpr where) {
    TestRules rules;
    const auto ten = [] { return Exprs{I(1'000), I(10), I(1'000'000'000'000)}; };
    rules.Msg("by_topic", And(where, Call(Builtin::kMsgCount, ten())), {{Alert("x")}});
    rules.Msg("by_sender", And(where, Call(Builtin::kSenderCount, ten())), {{Alert("x")}});
    return rules;
  }

  Outcome Lose(model::Loss loss) { return robot_.Judge(ExternalEvent(std::move(loss))); }
  // Names of the rules that fire for one message.
  std::string Fired(const std::string& topic, uint8_t writer, const std::string& type = kType) {
    const Outcome outcome =
        robot_.Judge(MessageEvent{.topic = topic, .type = type, .writer = Writer(writer)});
    std::string names;
    for (const Effect& effect : outcome.effects) {
      names += std::get<AlertEffect>(effect).rule + " ";
    }
    return names;
  }

  TestRobot robot_{Rules(B(true))};
};

TEST_F(MessageCountsTest, WhatOneWriterLostCountsForItAndItsTopic) {
  Lose({.count = 9, .topic = "/a", .type = kType, .writer = Writer(1)});
  EXPECT_EQ(Fired("/a", 2), "by_topic ");
  EXPECT_EQ(Fired("/a", 1), "by_topic by_sender ");
  EXPECT_EQ(Fired("/b", 1), "");
  robot_.Advance(1'000 * kNanosPerMilli);
  EXPECT_EQ(Fired("/a", 1), "");
}

TEST_F(MessageCountsTest, WhatUnknownWritersLostCountsForEveryWriterOfTheTopic) {
  Lose({.count = 9, .topic = "/a", .type = kType});
  EXPECT_EQ(Fired("/a", 1), "by_topic by_sender ");
  EXPECT_EQ(Fired("/a", 2), "by_topic by_sender ") << "nor one that was never seen";
  EXPECT_EQ(Fired("/b", 1), "");
}

TEST_F(MessageCountsTest, WhatWasLostOfUnknownTopicsCountsForAll) {
  Lose({.count = 9});
  EXPECT_EQ(Fired("/a", 1), "by_topic by_sender ");
  EXPECT_EQ(Fired("/never_seen", 2), "by_topic by_sender ");
  robot_.Advance(1'000 * kNanosPerMilli);
  EXPECT_EQ(Fired("/a", 1), "");
}

TEST_F(MessageCountsTest, NamesThatAreMadeUpDoNotPushOutWhatWasLostAnywhere) {
  Lose({.count = 9});
  for (size_t i = 0; i < 2 * CountWindows::kKeysMax; ++i) {
    Lose({.count = 1, .topic = absl::StrCat("/made_up_", i)});
  }
  robot_.Advance(1);
  EXPECT_EQ(Fired("/a", 1), "by_topic by_sender ");
}

TEST_F(MessageCountsTest, WhatWasLostWithoutATypeCountsAsIfEveryRuleApplied) {
  TestRules rules = Rules(Call(Builtin::kMsgTypeIn, Texts({"std_msgs"})));
  robot_ = TestRobot(rules);
  Lose({.count = 9, .topic = "/a"});
  EXPECT_EQ(Fired("/a", 1), "by_topic by_sender ");
  Lose({.count = 9, .topic = "/b", .type = "other_msgs/msg/A"});
  EXPECT_EQ(Fired("/b", 1), "") << "no rule applies to what was lost";
  Lose({.count = 9, .topic = "/c", .type = kType});
  EXPECT_EQ(Fired("/c", 1), "by_topic by_sender ");
}

TEST_F(MessageCountsTest, WhatWasLostEarlierIsOutsideTheWindow) {
  const int64_t now = robot_.now.unix_ns;
  Lose({.count = 9,
        .topic = "/a",
        .first_ns = now - 2 * kNanosPerSecond,
        .last_ns = now - kNanosPerSecond});
  EXPECT_EQ(Fired("/a", 1), "");
  // 18 in two seconds: 9 in the last.
  Lose({.count = 18, .topic = "/b", .first_ns = now - 2 * kNanosPerSecond});
  EXPECT_EQ(Fired("/b", 1), "by_topic by_sender ");
}

TEST_F(MessageCountsTest, TimesThatCannotBeAreTakenAsNow) {
  const int64_t now = robot_.now.unix_ns;
  Lose({.count = 9,
        .topic = "/a",
        .first_ns = now + 5 * kNanosPerSecond,
        .last_ns = now + 3 * kNanosPerSecond});
  EXPECT_EQ(Fired("/a", 1), "by_topic by_sender ");
  robot_.Advance(1'001 * kNanosPerMilli);
  EXPECT_EQ(Fired("/a", 1), "");
}

TEST_F(MessageCountsTest, CountsWithoutBoundAreCut) {
  for (int i = 0; i < 3; ++i) Lose({.count = UINT64_MAX, .topic = "/a", .writer = Writer(1)});
  EXPECT_EQ(Fired("/a", 1), "by_topic by_sender ") << "they have not come round to a few";
}

TEST_F(MessageCountsTest, ALossAloneFiresNoMessageRule) {
  const Outcome outcome = Lose({.count = 1'000, .topic = "/a", .type = kType});
  EXPECT_EQ(outcome.fired, 0u);
}

TEST_F(MessageCountsTest, WhereNoRuleCountsNothingIsKept) {
  TestRules rules;
  rules.Msg("r", B(true), {{Alert("x")}});
  robot_ = TestRobot(rules);
  Lose({.count = 9});
  Lose({.count = 9, .topic = "/a"});
  const RobotState::Internal& in = robot_.state.internal();
  EXPECT_EQ(in.counts.keys() + in.lost_by_anybody.keys() + in.lost_anywhere.keys(), 0u);
}

}  // namespace
}  // namespace rips::engine
