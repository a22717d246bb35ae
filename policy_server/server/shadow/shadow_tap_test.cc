#include "policy_server/server/shadow/shadow_tap.h"

#include <string>

#include "policy_server/server/shadow/shadow_test_data.h"

namespace rips::shadow {
namespace {

class ShadowTapTest : public ::testing::Test {
 protected:
  size_t PopAll() {
    size_t count = 0;
    while (tap_.Pop().has_value()) ++count;
    return count;
  }

  int woken_ = 0;
  ShadowTap tap_{[this] { ++woken_; }};
  const std::shared_ptr<const ros2::RosGraph> graph_ = GraphOf({"/camera"});
};

TEST_F(ShadowTapTest, AFullQueueDropsCountsAndTakesLevelsStill) {
  for (size_t i = 0; i < ShadowTap::kEventsMax + 10; ++i) {
    EXPECT_TRUE(tap_.OnEvent(TickAt(graph_)));
  }
  EXPECT_EQ(tap_.live().missed, 10u);
  EXPECT_EQ(woken_, 1) << "once while it is not empty";
  for (size_t i = 0; i < ShadowTap::kLevelsMore + 1; ++i) {
    EXPECT_TRUE(tap_.OnLevel({.to = "ALERT", .cause = "operator alice"}));
  }
  EXPECT_EQ(tap_.live().missed, 11u);
  EXPECT_EQ(tap_.live().level, "ALERT");
  // What the thread has taken out and not judged counts still.
  ASSERT_TRUE(tap_.Pop().has_value());
  EXPECT_EQ(tap_.events(), ShadowTap::kEventsMax + ShadowTap::kLevelsMore - 1);
  EXPECT_EQ(PopAll(), ShadowTap::kEventsMax + ShadowTap::kLevelsMore - 1);
  EXPECT_EQ(tap_.bytes(), 0u);
  EXPECT_TRUE(tap_.OnEvent(TickAt(graph_)));
  EXPECT_EQ(woken_, 2);
}

TEST_F(ShadowTapTest, ABatchIsCountedOnceForAllThatKeepItAlive) {
  JudgedEvent big = MessageOn("/a", graph_, 1, std::string(1 << 20, 'x'));
  tap_.OnEvent(big);
  const size_t one = tap_.bytes();
  EXPECT_GE(one, size_t{1} << 20);
  for (int i = 0; i < 100; ++i) tap_.OnEvent(big);
  EXPECT_LT(tap_.bytes(), one + (1 << 20));
  EXPECT_EQ(tap_.live().missed, 0u);
  // As long as one of them waits, all of it is there.
  for (int i = 0; i < 100; ++i) ASSERT_TRUE(tap_.Pop().has_value());
  EXPECT_GE(tap_.bytes(), size_t{1} << 20);
  ASSERT_TRUE(tap_.Pop().has_value());
  EXPECT_EQ(tap_.bytes(), 0u);
}

TEST_F(ShadowTapTest, PastItsBytesItDropsButNeverTheOnlyOne) {
  const std::string payload(size_t{4} << 20, 'x');
  for (int i = 0; i < 5; ++i) tap_.OnEvent(MessageOn("/a", graph_, 1, payload));
  EXPECT_EQ(tap_.live().missed, 3u);
  EXPECT_EQ(PopAll(), 2u);
  tap_.OnEvent(MessageOn("/a", graph_, 1, std::string(2 * ShadowTap::kBytesMax, 'x')));
  EXPECT_EQ(tap_.live().missed, 3u);
  tap_.OnEvent(TickAt(graph_));
  EXPECT_EQ(tap_.live().missed, 4u);
}

TEST_F(ShadowTapTest, GraphsInTurnAreCountedOnce) {
  const auto other = GraphOf({"/camera", "/b"});
  tap_.OnEvent(MessageOn("/a", graph_));
  tap_.OnEvent(MessageOn("/a", other));
  const size_t two = tap_.bytes();
  tap_.OnEvent(TickAt(graph_));
  const size_t tick = tap_.bytes() - two;
  for (int i = 0; i < 8; ++i) tap_.OnEvent(TickAt(i % 2 == 0 ? graph_ : other));
  EXPECT_EQ(tap_.bytes(), two + 9 * tick);
}

TEST_F(ShadowTapTest, WhatWaitsViewsWhatItKeepsAlive) {
  {
    JudgedEvent judged =
        MessageOn("/topic/of/some/length", GraphOf({"/x"}), 1, "payload", "/sender/of/some/length");
    engine::TopicMemo memo;
    const engine::Verdict verdict = engine::Verdict::kYes;
    auto& message = std::get<engine::MessageEvent>(judged.event.what);
    message.memo = &memo;
    message.inspections = absl::MakeConstSpan(&verdict, 1);
    tap_.OnEvent(judged);
  }
  const auto item = tap_.Pop();
  ASSERT_TRUE(item.has_value());
  const auto& judged = std::get<JudgedEvent>(*item);
  const auto& message = std::get<engine::MessageEvent>(judged.event.what);
  EXPECT_EQ(message.topic, "/topic/of/some/length");
  EXPECT_EQ(message.sender, "/sender/of/some/length");
  EXPECT_EQ(judged.message->payload, "payload");
  EXPECT_EQ(judged.graph->nodes().size(), 1u);
  EXPECT_EQ(message.memo, nullptr) << "the robot's thread writes to it";
  EXPECT_TRUE(message.inspections.empty());
}

TEST_F(ShadowTapTest, ClosedItTakesNothingAndSaysSo) {
  tap_.OnBegin(StateOf(graph_, "ALERT"));
  EXPECT_TRUE(tap_.OnOutcome({.counts = {.alerts = 2, .raises = 1}, .level = "HALT"}));
  EXPECT_TRUE(tap_.OnOutcome({.counts = {.alerts = 3, .faults = 1}, .level = "HALT"}));
  tap_.OnEvent(TickAt(graph_));
  tap_.Close();
  EXPECT_FALSE(tap_.OnEvent(TickAt(graph_)));
  EXPECT_FALSE(tap_.OnLevel({.to = "DEFAULT"}));
  EXPECT_FALSE(tap_.OnOutcome({.counts = {.alerts = 1}, .level = "DEFAULT"}));
  EXPECT_FALSE(tap_.Pop().has_value());
  EXPECT_EQ(tap_.bytes(), 0u);
  EXPECT_EQ(tap_.live().counts, (ShadowCounts{.alerts = 5, .raises = 1, .faults = 1}));
  EXPECT_EQ(tap_.live().level, "HALT");
}

}  // namespace
}  // namespace rips::shadow
