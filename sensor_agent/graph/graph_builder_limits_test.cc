// What the graph leaves out when it is at its limits, and whose.
#include <algorithm>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/graph/graph_builder.h"
#include "sensor_agent/graph/graph_builder_fixture.h"
#include "sensor_agent/outbox/outbox.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::Field;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

class SmallLimitsTest : public GraphBuilderTest {
 protected:
  SmallLimitsTest()
      : GraphBuilderTest(
            {.limits = {.nodes = 2, .endpoints = 4, .participants = 3}, .step_bytes = 600}) {}
};

TEST_F(SmallLimitsTest, ExcessIsLeftOutAndCounted) {
  Participant(1);
  Participant(2);
  Participant(3);  // with our own the fourth
  EXPECT_EQ(builder_->counters().dropped, 1);
  for (uint16_t i = 1; i <= 5; ++i) Writer(1, i, "rt/x");
  EXPECT_EQ(builder_->counters().dropped, 2);
  EXPECT_THAT(Claim(1, "a", {}), IsOk());
  EXPECT_THAT(builder_->NodesClaimed(EndpointGuid(2, 9),
                                     {.participant = ParticipantGuid(2),
                                      .nodes = {{.node_namespace = "/", .node_name = "b"},
                                                {.node_namespace = "/", .node_name = "c"}}},
                                     now_ns_),
              StatusIs(absl::StatusCode::kResourceExhausted, HasSubstr("more than 2 nodes")));
  EXPECT_EQ(builder_->counters().dropped, 3);
  Settle();
  EXPECT_THAT(Nodes(), ElementsAre("/a", "/b", "/rips"));
  // What goes makes room.
  builder_->EndpointGone(EndpointGuid(1, 1), now_ns_);
  Writer(1, 6, "rt/x");
  EXPECT_THAT(Claim(1, "d", {}), IsOk());
  EXPECT_EQ(builder_->counters().dropped, 3);
}

TEST_F(SmallLimitsTest, WhatIsLeftOutIsToldWithTheFirstPieceAndOverWithTheLast) {
  Participant(1);
  for (uint16_t i = 1; i <= 4; ++i) {
    Writer(1, i, absl::StrCat("rt/", std::string(200, 'x'), i));
  }
  for (uint16_t i = 5; i <= 9; ++i) Writer(1, i, "rt/y");
  Pass(2'000);
  ASSERT_GT(changes_.size(), 1u);
  ASSERT_TRUE(changes_[0].delta.truncation.has_value());
  EXPECT_EQ(changes_[0].delta.truncation->left_out, 8u) << "five, rounded up";
  EXPECT_THAT(changes_[0].delta.truncation->crowds,
              ElementsAre(ros2::Truncation::Crowd{ParticipantGuid(1), 4, 8}));
  for (size_t i = 1; i < changes_.size(); ++i) EXPECT_FALSE(changes_[i].delta.truncation);
  EXPECT_EQ(graph_.left_out(), 8u);

  // More of the same is seldom news.
  changes_.clear();
  Writer(1, 10, "rt/y");
  Pass(20);
  EXPECT_THAT(changes_, IsEmpty());
  for (uint16_t i = 11; i <= 20; ++i) Writer(1, i, "rt/y");
  Pass(20);
  ASSERT_THAT(changes_, SizeIs(1)) << "a step of its own, though the graph is as before";
  EXPECT_EQ(graph_.left_out(), 16u);
  // A server that lost the graph gets it again.
  graph_.Clear();
  version_ = 0;
  Apply(builder_->Snapshot(now_ns_));
  EXPECT_EQ(graph_.left_out(), 16u);

  changes_.clear();
  builder_->EndTruncation();
  EXPECT_LE(builder_->NextDue(), now_ns_);
  Pass(20);
  ASSERT_THAT(changes_, SizeIs(1));
  EXPECT_FALSE(graph_.truncated());
}

TEST_F(SmallLimitsTest, FactsThatNeverCameAreLeftOut) {
  Settle();
  builder_->FactsLost(3);
  Pass(20);
  EXPECT_EQ(graph_.left_out(), 4u);
  EXPECT_EQ(builder_->counters().dropped, 0u) << "the caller counts them";
}

// An endpoint that is not shown takes no place: else a flood of reply writers would push out all others in
// a graph that looks whole.
TEST_F(SmallLimitsTest, RepliesTakeNoPlaceAndNothingIsMissingWithoutThem) {
  Participant(1);
  for (uint16_t i = 1; i <= 50; ++i) Writer(1, i, absl::StrCat("rr/s", i, "Reply"));
  Settle();
  EXPECT_FALSE(graph_.truncated());
  Participant(2);
  Writer(2, 1, "rt/cmd_vel");
  Pass(600);
  EXPECT_THAT(Publishers("/cmd_vel"), SizeIs(1));
  EXPECT_FALSE(graph_.truncated());
}

class SharedLimitsTest : public GraphBuilderTest {
 protected:
  SharedLimitsTest()
      : GraphBuilderTest({.limits = {.nodes = 8,
                                     .endpoints = 6,
                                     .endpoints_per_participant = 4,
                                     .nodes_per_participant = 2}}) {}
  void Keep(const std::string& topic) {
    builder_->SetKeptTopics(std::make_shared<const ros2::TopicNames>(ros2::TopicNames{topic}));
  }
  void Flood(uint8_t participant, uint16_t count) {
    Participant(participant);
    for (uint16_t i = 0; i < count; ++i) {
      Writer(participant, static_cast<uint16_t>(100 + i),
             absl::StrCat("rt/f", participant, "_", i));
    }
  }
};

TEST_F(SharedLimitsTest, OneParticipantLeavesRoomForOthers) {
  Flood(1, 50);
  Talker(2, "driver", "rt/cmd_vel");
  Settle();
  EXPECT_THAT(Publishers("/cmd_vel"), ElementsAre("/driver"));
  EXPECT_GE(graph_.left_out(), 46u);
  EXPECT_THAT(graph_.truncation().crowds,
              ElementsAre(ros2::Truncation::Crowd{ParticipantGuid(1), 4, 64}));
}

TEST_F(SharedLimitsTest, TheSecondDriverOfANamedTopicIsKept) {
  Keep("/cmd_vel");
  Talker(3, "driver", "rt/cmd_vel");
  Flood(1, 50);
  Flood(2, 50);
  Settle();
  Talker(4, "second", "rt/cmd_vel");
  Talker(5, "third", "rt/odom");
  Pass(20);
  EXPECT_THAT(Publishers("/cmd_vel"), ElementsAre("/driver", "/second"));
  EXPECT_THAT(Publishers("/odom"), IsEmpty());
  EXPECT_TRUE(graph_.truncated());
  // The flooder itself, although it holds its share.
  Writer(1, 1, "rt/cmd_vel");
  Pass(600);
  EXPECT_THAT(Publishers("/cmd_vel"), SizeIs(3));
}

TEST_F(SharedLimitsTest, NodesHaveAShareToo) {
  Participant(1);
  ros2::ParticipantEntities claim{.participant = ParticipantGuid(1)};
  for (int i = 0; i < 5; ++i) {
    claim.nodes.push_back({.node_namespace = "/", .node_name = absl::StrCat("n", i)});
  }
  EXPECT_FALSE(builder_->NodesClaimed(EndpointGuid(1, 9), claim, now_ns_).ok());
  Participant(2);
  EXPECT_THAT(Claim(2, "other", {}), IsOk());
  Settle();
  EXPECT_THAT(Nodes(), ElementsAre("/n0", "/n1", "/other", "/rips"));
  EXPECT_EQ(graph_.left_out(), 4u);
}

TEST_F(SharedLimitsTest, HasRoomWhenTheFlooderIsGone) {
  Flood(1, 4);
  EXPECT_TRUE(builder_->HasRoom()) << "half of four is an eighth of none";
  Settle();
  builder_->ParticipantGone(ParticipantGuid(1), now_ns_);
  Pass(20);
  EXPECT_TRUE(builder_->HasRoom());
}

TEST_F(SmallLimitsTest, LargeStepIsSentInPiecesOfWhichTheLastIsSettled) {
  Talker(1, "talker", "rt/chatter_with_a_long_name");
  Participant(2);
  for (uint16_t i = 1; i <= 3; ++i) {
    Writer(2, i, absl::StrCat("rt/", std::string(60, 'x'), i));
  }
  Pass(2'000);
  ASSERT_GT(changes_.size(), 1u);
  for (size_t i = 0; i < changes_.size(); ++i) {
    EXPECT_EQ(changes_[i].settled, i + 1 == changes_.size()) << i;
  }
  EXPECT_THAT(graph_.endpoints(), SizeIs(8)) << "4 of others and 4 of ours";
}

}  // namespace
}  // namespace rips::sensor
