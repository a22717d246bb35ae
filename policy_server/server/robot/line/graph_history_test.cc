#include "policy_server/server/robot/line/graph_history.h"

#include <memory>
#include <string>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"

namespace rips::pipeline {
namespace {

constexpr char kLive[] = "live............";
constexpr char kFormer[] = "former..........";

ros2::Guid Writer(uint32_t n) {
  ros2::Guid guid;
  guid.bytes = {
      1, 0x10, static_cast<uint8_t>(n), static_cast<uint8_t>(n >> 8), 0, 0, 0, 0, 0, 0, 0, 0, 0, 0,
      2, 3};
  return guid;
}

class GraphHistoryTest : public ::testing::Test {
 protected:
  // A graph that shows `writers`; `pending` of them as pending.
  void Add(uint64_t number, std::initializer_list<uint32_t> writers, bool pending = false,
           const std::string& incarnation = kLive, ros2::GraphLimits limits = {}) {
    ros2::RosGraph graph(limits);
    ros2::GraphDelta delta;
    for (const uint32_t n : writers) {
      const ros2::Guid participant = Writer(n).Participant();
      const std::string node = absl::StrCat("/n", n);
      delta.upsert_participants.push_back({.guid = participant});
      delta.upsert_nodes.push_back({.full_name = node, .participant = participant});
      delta.upsert_endpoints.push_back({.guid = Writer(n),
                                        .name = "/t",
                                        .type = "a/msg/B",
                                        .node = pending ? "" : node,
                                        .pending = pending});
    }
    ASSERT_TRUE(graph.Apply(delta).ok());
    newest_ = {std::make_shared<const ros2::RosGraph>(std::move(graph)), ++revision_};
    history_.Add(incarnation, number, newest_, now_ns_);
  }
  GraphHistory::Choice Choose(uint64_t number, uint32_t writer, bool live = true,
                              const GraphHistory::Version* brought = nullptr) const {
    return history_.Choose(live ? kLive : kFormer, live, number, Writer(writer), newest_, brought);
  }

  int64_t now_ns_ = 1;
  uint64_t revision_ = 1;
  GraphHistory::Version newest_ = {std::make_shared<const ros2::RosGraph>(), 1};
  GraphHistory history_;
};

TEST_F(GraphHistoryTest, BeforeTheFirstGraphOnlyALiveMessageThatNamesAVersionWaits) {
  EXPECT_TRUE(Choose(1, 1).wait);
  EXPECT_FALSE(Choose(0, 1).wait) << "no version is named";
  EXPECT_FALSE(Choose(1, 1, /*live=*/false).wait) << "its graph will not come any more";
}

TEST_F(GraphHistoryTest, AMessageWaitsForTheVersionThatShowsItsWriter) {
  Add(1, {1});
  EXPECT_EQ(Choose(1, 1).version->revision, newest_.revision);
  EXPECT_EQ(Choose(1, 1).writer->node, "/n1");
  EXPECT_TRUE(Choose(2, 1).wait) << "version 2 has not come";
  EXPECT_TRUE(Choose(1, 2).wait) << "a step in several pieces: the writer is in a later one";

  Add(2, {1, 2});
  EXPECT_FALSE(Choose(2, 2).wait);
  EXPECT_EQ(Choose(1, 2).version->revision, newest_.revision);
}

TEST_F(GraphHistoryTest, AMessageIsJudgedAgainstTheGraphOfItsTimeWhenTheWriterHasGone) {
  Add(1, {1});
  const uint64_t then = newest_.revision;
  Add(2, {});

  const GraphHistory::Choice choice = Choose(1, 1);

  EXPECT_FALSE(choice.wait);
  EXPECT_EQ(choice.version->revision, then);
  EXPECT_EQ(choice.writer->node, "/n1");
}

TEST_F(GraphHistoryTest, APendingWriterIsWaitedFor) {
  Add(1, {1}, /*pending=*/true);
  EXPECT_TRUE(Choose(1, 1).wait);
  Add(2, {1});
  EXPECT_EQ(Choose(1, 1).writer->node, "/n1");
}

TEST_F(GraphHistoryTest, AMessageWithoutWriterWaitsForItsVersionOnly) {
  Add(1, {1});
  EXPECT_FALSE(history_.Choose(kLive, true, 1, ros2::Guid(), newest_, nullptr).wait);
  EXPECT_TRUE(history_.Choose(kLive, true, 2, ros2::Guid(), newest_, nullptr).wait);
}

TEST_F(GraphHistoryTest, AWriterThatWasGivenUpIsNotWaitedForUntilTheGraphChanges) {
  Add(1, {1});
  history_.GiveUp(Writer(2));
  EXPECT_TRUE(Choose(1, 2).unattributed);
  EXPECT_FALSE(Choose(1, 2).wait);
  EXPECT_TRUE(Choose(1, 3).wait);

  Add(2, {1});
  EXPECT_TRUE(Choose(1, 2).wait);
}

TEST_F(GraphHistoryTest, WritersThatAreGivenUpHaveALimit) {
  Add(1, {1});
  for (uint32_t n = 0; n < GraphHistory::kGivenUpMax + 10; ++n) history_.GiveUp(Writer(100 + n));
  EXPECT_FALSE(Choose(1, 100).wait);
  EXPECT_TRUE(Choose(1, 100 + GraphHistory::kGivenUpMax).wait) << "it waits each time";
}

TEST_F(GraphHistoryTest, ATruncatedGraphIsNotWaitedFor) {
  Add(1, {1, 2}, /*pending=*/false, kLive, {.endpoints = 1});
  ASSERT_TRUE(newest_.graph->truncated());
  EXPECT_FALSE(Choose(1, 2).wait) << "the writer may have been left out";
  EXPECT_FALSE(Choose(1, 2).unattributed) << "the sensor knows its node";
}

TEST_F(GraphHistoryTest, WhatWasForgottenIsJudgedAgainstTheOldestThatIsHeld) {
  for (uint64_t n = 1; n <= GraphHistory::kVersionsMax + 10; ++n) Add(n, {1});
  EXPECT_EQ(history_.size(), GraphHistory::kVersionsMax + 1);
  const GraphHistory::Choice choice = Choose(2, 7);
  EXPECT_FALSE(choice.wait);
  EXPECT_FALSE(choice.unattributed);
  EXPECT_LT(choice.version->revision, newest_.revision);
}

TEST_F(GraphHistoryTest, LargeGraphsAreForgottenSooner) {
  ros2::GraphDelta delta;
  const size_t each = GraphHistory::kEndpointsMax / 2 - 1;
  for (size_t i = 0; i < each; ++i) {
    ros2::Guid guid = Writer(static_cast<uint8_t>(1 + i / 1'000));
    if (i % 1'000 == 0) delta.upsert_participants.push_back({.guid = guid.Participant()});
    guid.bytes[12] = static_cast<uint8_t>(i >> 8);
    guid.bytes[13] = static_cast<uint8_t>(i);
    delta.upsert_endpoints.push_back({.guid = guid, .name = "/t", .type = "a/msg/B"});
  }
  ros2::RosGraph graph;
  ASSERT_TRUE(graph.Apply(delta).ok());
  const auto shared = std::make_shared<const ros2::RosGraph>(std::move(graph));
  for (uint64_t n = 1; n <= 10; ++n) history_.Add(kLive, n, {shared, n}, now_ns_);
  EXPECT_EQ(history_.size(), 3u);
}

TEST_F(GraphHistoryTest, OldVersionsGoUnlessABacklogMayNameThem) {
  Add(1, {1});
  Add(2, {1});
  now_ns_ += GraphHistory::kKeptNs + 1;
  history_.Expire(now_ns_, /*backlog=*/true);
  EXPECT_EQ(history_.size(), 2u);
  history_.Expire(now_ns_, /*backlog=*/false);
  EXPECT_EQ(history_.size(), 1u);
  EXPECT_EQ(history_.number(), 2u) << "the newest stays";
}

TEST_F(GraphHistoryTest, MessagesOfAFormerIncarnationAreJudgedAgainstItsGraph) {
  Add(7, {1}, /*pending=*/false, kFormer);
  const uint64_t then = newest_.revision;
  Add(1, {});

  EXPECT_EQ(Choose(7, 1, /*live=*/false).version->revision, then);
  EXPECT_EQ(Choose(9, 1, /*live=*/false).version->revision, then) << "version 9 will not come";
  EXPECT_FALSE(Choose(9, 1, /*live=*/false).wait);
}

TEST_F(GraphHistoryTest, AMessageThatOutlivedItsGraphIsMarkedUnlessItsWriterIsStillThere) {
  Add(1, {1});
  EXPECT_TRUE(Choose(7, 2, /*live=*/false).outlived);
  EXPECT_FALSE(Choose(7, 1, /*live=*/false).outlived) << "the same process as then";
  EXPECT_FALSE(Choose(1, 1).outlived);
  Add(7, {1}, /*pending=*/false, kFormer);
  EXPECT_FALSE(Choose(7, 2, /*live=*/false).outlived) << "its graph is held";
}

TEST_F(GraphHistoryTest, AMessageWhoseGraphIsNotHeldIsJudgedByTheOneThatCameWithIt) {
  Add(9, {2}, /*pending=*/false, "another.........");
  const GraphHistory::Version brought = newest_;
  Add(1, {1});
  const auto choice = Choose(7, 2, /*live=*/false, &brought);
  EXPECT_EQ(choice.version->revision, brought.revision);
  EXPECT_EQ(choice.writer->node, "/n2");
  EXPECT_FALSE(Choose(7, 3, /*live=*/false, &brought).outlived) << "nobody, then as now";
  EXPECT_TRUE(Choose(2, 2, /*live=*/true, &brought).wait) << "its own graph will come";
  Add(7, {3}, /*pending=*/false, kFormer);
  EXPECT_EQ(Choose(7, 3, /*live=*/false, &brought).version->revision, newest_.revision)
      << "what is held is exact";
}

TEST_F(GraphHistoryTest, ANewIncarnationWaitsForItsOwnGraph) {
  Add(7, {1}, /*pending=*/false, kFormer);
  EXPECT_TRUE(Choose(1, 1).wait) << "the graph held is of another process";
}

}  // namespace
}  // namespace rips::pipeline
