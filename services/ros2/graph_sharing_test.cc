// Who has room in a graph at its limits, row by row of graph_limits.h, and what is said of the rest.
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/ros2/ros_graph.h"

namespace rips::ros2 {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

Guid Owner(uint8_t participant) {
  Guid guid;
  guid.bytes[11] = participant;
  return guid.Participant();
}

// Entity ids above and below that of the participant.
Guid Entity(uint8_t participant, uint16_t number) {
  Guid guid = Owner(participant);
  guid.bytes[12] = static_cast<uint8_t>(number % 2);
  guid.bytes[13] = static_cast<uint8_t>(number >> 8);
  guid.bytes[14] = static_cast<uint8_t>(number);
  guid.bytes[15] = 0x03;
  return guid;
}

std::shared_ptr<const TopicNames> Kept() {
  return std::make_shared<const TopicNames>(TopicNames{"/cmd_vel"});
}

class GraphSharingTest : public testing::Test {
 protected:
  // Participants 1 to 4, a node each.
  void Begin(GraphLimits limits, bool keep = true) {
    graph_ = RosGraph(limits);
    if (keep) graph_.SetKeptTopics(Kept());
    GraphDelta delta;
    for (uint8_t i = 1; i <= 4; ++i) {
      delta.upsert_participants.push_back({.guid = Owner(i)});
      delta.upsert_nodes.push_back({absl::StrCat("/n", i), Owner(i)});
    }
    ASSERT_THAT(graph_.Apply(delta), IsOk());
  }
  void Publish(uint8_t participant, uint16_t number, const std::string& topic,
               EndpointKind kind = EndpointKind::kPublisher) {
    GraphDelta delta;
    delta.upsert_endpoints = {{.guid = Entity(participant, number),
                               .kind = kind,
                               .name = topic,
                               .type = "a/msg/B",
                               .node = absl::StrCat("/n", participant)}};
    ASSERT_THAT(graph_.Apply(delta), IsOk());
  }
  void Flood(uint8_t participant, uint16_t count, uint16_t first = 100) {
    for (uint16_t i = 0; i < count; ++i) {
      Publish(participant, static_cast<uint16_t>(first + i),
              absl::StrCat("/t", participant, "_", i));
    }
  }
  size_t Held(uint8_t participant) const {
    size_t held = 0;
    for (const auto& [guid, endpoint] : graph_.endpoints()) {
      held += guid.SamePrefix(Owner(participant)) ? 1 : 0;
    }
    return held;
  }
  std::vector<std::string> Drivers() const {
    const Topic* topic = graph_.FindTopic("/cmd_vel");
    return topic == nullptr ? std::vector<std::string>() : topic->publishers;
  }

  RosGraph graph_;
};

TEST_F(GraphSharingTest, OneParticipantDoesNotPushOutTheOthers) {
  Begin({.endpoints = 8, .endpoints_per_participant = 3});
  Flood(1, 7);
  EXPECT_EQ(Held(1), 3u);
  Flood(2, 2);
  EXPECT_EQ(Held(2), 2u);
  EXPECT_EQ(graph_.left_out(), 4u);
  EXPECT_THAT(graph_.truncation().crowds, ElementsAre(Truncation::Crowd{Owner(1), 3, 4}));
}

TEST_F(GraphSharingTest, AKeptEndpointTakesThePlaceOfAnotherOfTheSameParticipant) {
  Begin({.endpoints = 8, .endpoints_per_participant = 3});
  Flood(1, 3);
  Publish(1, 1, "/cmd_vel");
  EXPECT_THAT(Drivers(), ElementsAre("/n1"));
  EXPECT_EQ(Held(1), 3u);
  EXPECT_EQ(graph_.left_out(), 1u);
  // All it holds is kept: nothing goes for the fourth.
  Publish(1, 2, "/cmd_vel");
  Publish(1, 3, "/cmd_vel");
  Publish(1, 4, "/cmd_vel");
  EXPECT_THAT(Drivers(), SizeIs(3));
  EXPECT_EQ(graph_.left_out(), 4u);
}

TEST_F(GraphSharingTest, InAFullGraphAKeptEndpointTakesThePlaceOfOneOfTheLargest) {
  Begin({.endpoints = 6});
  Publish(2, 1, "/odom");
  Flood(1, 3);
  Flood(4, 2);
  Publish(3, 1, "/cmd_vel");
  EXPECT_THAT(Drivers(), ElementsAre("/n3"));
  EXPECT_EQ(Held(1), 2u) << "it had most";
  EXPECT_EQ(Held(2), 1u);
  EXPECT_EQ(Held(4), 2u);
  EXPECT_EQ(graph_.endpoints().size(), 6u);
  EXPECT_THAT(graph_.truncation().crowds, ElementsAre(Truncation::Crowd{Owner(1), 2, 1}));
  Publish(3, 2, "/scan");
  EXPECT_EQ(graph_.FindTopic("/scan"), nullptr) << "no rule names it";
  EXPECT_EQ(graph_.left_out(), 2u);
}

TEST_F(GraphSharingTest, WhereAllIsKeptNothingGoes) {
  Begin({.endpoints = 3});
  for (uint16_t i = 1; i <= 5; ++i) Publish(1, i, "/cmd_vel");
  EXPECT_THAT(Drivers(), SizeIs(3));
  EXPECT_EQ(graph_.left_out(), 2u);
}

TEST_F(GraphSharingTest, ServicesOfAKeptNameAreNotKept) {
  Begin({.endpoints = 1});
  Publish(1, 1, "/t");
  Publish(2, 1, "/cmd_vel", EndpointKind::kService);
  EXPECT_NE(graph_.FindTopic("/t"), nullptr);
}

TEST_F(GraphSharingTest, AKeptTopicNeedsNoRoomAmongTheTopics) {
  Begin({.topics = 2});
  Flood(1, 3);
  Publish(2, 1, "/cmd_vel");
  EXPECT_EQ(graph_.topics().size(), 3u);
  EXPECT_THAT(Drivers(), ElementsAre("/n2"));
}

TEST_F(GraphSharingTest, NodesHaveAShareToo) {
  Begin({.nodes = 10, .nodes_per_participant = 2});
  GraphDelta delta;
  for (int i = 0; i < 5; ++i) delta.upsert_nodes.push_back({absl::StrCat("/more", i), Owner(1)});
  delta.upsert_nodes.push_back({"/other", Owner(2)});
  ASSERT_THAT(graph_.Apply(delta), IsOk());
  EXPECT_EQ(graph_.nodes().size(), 6u);
  EXPECT_EQ(graph_.left_out(), 4u);
  // What goes makes room for others of it.
  ASSERT_THAT(graph_.Apply({.upsert_nodes = {{"/new", Owner(1)}}, .gone_nodes = {"/n1"}}), IsOk());
  EXPECT_EQ(graph_.nodes().size(), 6u);
  EXPECT_EQ(graph_.left_out(), 4u);
}

TEST_F(GraphSharingTest, AnEndpointStaysWhoseNodeWasLeftOut) {
  Begin({.nodes = 4});
  ASSERT_THAT(graph_.Apply({.upsert_nodes = {{"/second", Owner(2)}},
                            .upsert_endpoints = {{.guid = Entity(2, 1),
                                                  .name = "/cmd_vel",
                                                  .type = "a/msg/B",
                                                  .node = "/second"}}}),
              IsOk());
  EXPECT_EQ(graph_.left_out(), 2u);
  ASSERT_THAT(Drivers(), SizeIs(1));
  EXPECT_THAT(Drivers()[0], testing::StartsWith("(unattributed"));
}

TEST_F(GraphSharingTest, TheObserverTakesNoPlaceOfOthers) {
  Begin({.topics = 5, .endpoints = 2, .endpoints_per_participant = 2});
  graph_.SetObserver(Owner(4));
  for (uint16_t i = 1; i <= 5; ++i) {
    Publish(4, i, absl::StrCat("/t", i), EndpointKind::kSubscriber);
  }
  Flood(1, 2);
  EXPECT_EQ(Held(4), 5u);
  EXPECT_EQ(Held(1), 0u) << "there are five topics already";
  graph_.Clear();
  EXPECT_FALSE(graph_.truncated());
  EXPECT_EQ(graph_.limits().topics, 5u);
}

TEST_F(GraphSharingTest, OtherTopicsMayBeKeptFromNowOn) {
  Begin({.endpoints = 2}, /*keep=*/false);
  Flood(1, 2);
  Publish(2, 1, "/cmd_vel");
  EXPECT_THAT(Drivers(), IsEmpty());
  graph_.SetKeptTopics(Kept());
  Publish(2, 1, "/cmd_vel");
  EXPECT_THAT(Drivers(), SizeIs(1));
  graph_.SetKeptTopics(nullptr);
  EXPECT_EQ(graph_.left_out(), 2u);
}

TEST_F(GraphSharingTest, WhatTheSenderLeftOutIsLeftOut) {
  Begin({});
  EXPECT_FALSE(graph_.truncated());
  const Truncation told{.left_out = 8, .crowds = {{Owner(1), 5, 8}}};
  ASSERT_THAT(graph_.Apply({.truncation = told}), IsOk());
  EXPECT_TRUE(graph_.truncated());
  EXPECT_EQ(graph_.truncation(), told);
  EXPECT_EQ(graph_.dropped(), 0u);
  Publish(1, 1, "/t");
  EXPECT_TRUE(graph_.truncated()) << "nothing new was said";
  // A reference to nothing is an error all the same.
  EXPECT_FALSE(graph_.Apply({.upsert_nodes = {{"/x", Owner(9)}}}).ok());
  ASSERT_THAT(graph_.Apply({.truncation = Truncation{}}), IsOk());
  EXPECT_FALSE(graph_.truncated());
}

TEST_F(GraphSharingTest, CountsOfAHostileSenderDoNotWrapAround) {
  Begin({.endpoints = 1});
  Flood(1, 3);
  ASSERT_THAT(
      graph_.Apply({.truncation = Truncation{.left_out = ~uint64_t{0},
                                             .crowds = {{Owner(1), ~uint64_t{0}, ~uint64_t{0}}}}}),
      IsOk());
  EXPECT_EQ(graph_.left_out(), ~uint64_t{0});
  EXPECT_EQ(graph_.truncation().crowds[0].left_out, ~uint64_t{0});
  Truncation many{.left_out = 1};
  for (uint8_t i = 0; i < 100; ++i) many.crowds.push_back({Owner(i), 1, i});
  ASSERT_THAT(graph_.Apply({.truncation = many}), IsOk());
  EXPECT_THAT(graph_.truncation().crowds, SizeIs(Truncation::kCrowdsMax));
}

TEST_F(GraphSharingTest, ADifferenceCarriesWhatIsLeftOut) {
  Begin({.endpoints = 1});
  const RosGraph whole = graph_;
  Flood(1, 3);
  RosGraph copy = whole;
  ASSERT_THAT(copy.Apply(RosGraph::Diff(whole, graph_)), IsOk());
  EXPECT_EQ(copy.left_out(), graph_.left_out());
  EXPECT_TRUE(RosGraph::Diff(copy, graph_).empty());
  ASSERT_THAT(copy.Apply(RosGraph::Diff(copy, whole)), IsOk());
  EXPECT_FALSE(copy.truncated());
}

TEST_F(GraphSharingTest, HasRoomWithAnEighthOfEachLimitFree) {
  const GraphLimits room = {.topics = 5,
                            .nodes = 5,
                            .endpoints = 5,
                            .participants = 5,
                            .endpoints_per_participant = 4,
                            .nodes_per_participant = 2};
  const auto filled = [&](const GraphLimits& limits) {
    Begin(limits);
    Flood(1, 3);
    Publish(2, 1, "/t2");
    return graph_.HasRoom();
  };
  EXPECT_TRUE(filled(room)) << "an eighth of five is none";
  GraphLimits large = room;
  large.endpoints = 8;
  EXPECT_TRUE(filled(large));
  for (const auto& [limit, tight] : std::vector<std::pair<size_t GraphLimits::*, size_t>>{
           {&GraphLimits::topics, 3},
           {&GraphLimits::nodes, 3},
           {&GraphLimits::endpoints, 3},
           {&GraphLimits::participants, 3},
           {&GraphLimits::endpoints_per_participant, 2}}) {
    GraphLimits limits = room;
    limits.*limit = tight;
    EXPECT_TRUE(filled(limits)) << "all of the tight one is used, and an eighth of it is none";
    limits.*limit = 8;
    EXPECT_TRUE(filled(limits));
  }
  // Eight endpoints: seven are an eighth from full, eight are full.
  Begin({.endpoints = 8});
  Flood(1, 7);
  EXPECT_TRUE(graph_.HasRoom());
  Flood(2, 1);
  EXPECT_FALSE(graph_.HasRoom());
  Begin({.endpoints_per_participant = 8});
  Flood(1, 8);
  EXPECT_FALSE(graph_.HasRoom());
}

}  // namespace
}  // namespace rips::ros2
