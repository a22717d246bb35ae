#include "policy_server/server/robot/context/own_participants.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/server/robot/sight/graph_health.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

ros2::Guid Participant(uint8_t number) {
  ros2::Guid guid;
  guid.bytes[0] = number;
  guid.bytes[14] = 0x01;
  guid.bytes[15] = 0xc1;
  return guid;
}

class OwnParticipantsTest : public ::testing::Test {
 protected:
  std::vector<ros2::Guid> All() const {
    std::vector<ros2::Guid> all;
    own_.AppendTo(all);
    return all;
  }

  OwnParticipants own_;
};

TEST_F(OwnParticipantsTest, TheNewestStandsForEver) {
  EXPECT_THAT(All(), IsEmpty());
  own_.Add(Participant(1), 0);
  EXPECT_FALSE(own_.Expire(3'600 * kNanosPerSecond));
  EXPECT_THAT(All(), ElementsAre(Participant(1)));
}

TEST_F(OwnParticipantsTest, AnEarlierOneIsGivenUpThirtySecondsAfterTheNext) {
  own_.Add(Participant(1), 0);
  own_.Add(Participant(2), 10 * kNanosPerSecond);
  own_.Add(Participant(3), 20 * kNanosPerSecond);
  EXPECT_FALSE(own_.Expire(40 * kNanosPerSecond - 1));
  EXPECT_TRUE(own_.Expire(40 * kNanosPerSecond));
  EXPECT_THAT(All(), ElementsAre(Participant(2), Participant(3)));
}

TEST_F(OwnParticipantsTest, OneThatIsNamedAgainIsTheNewest) {
  own_.Add(Participant(1), 0);
  own_.Add(Participant(2), 0);
  own_.Add(Participant(1), 0);
  EXPECT_TRUE(own_.Expire(OwnParticipants::kKeptNs));
  EXPECT_THAT(All(), ElementsAre(Participant(1)));
}

TEST_F(OwnParticipantsTest, AKeyThatNamesManyHasTheNewestEight) {
  for (uint8_t i = 0; i < 100; ++i) own_.Add(Participant(i), 0);
  EXPECT_THAT(All(), SizeIs(OwnParticipants::kMax));
  EXPECT_EQ(All().back(), Participant(99));
}

TEST_F(OwnParticipantsTest, AParticipantWithANodeOfTheRobotIsForeign) {
  ros2::RosGraph graph;
  ros2::GraphDelta delta;
  delta.upsert_participants = {{.guid = Participant(1)}, {.guid = Participant(2)}};
  delta.upsert_nodes = {{.full_name = "/driver", .participant = Participant(1)},
                        {.full_name = std::string(kRipsNode), .participant = Participant(2)}};
  ASSERT_TRUE(graph.Apply(delta).ok());
  EXPECT_EQ(ForeignNodeOf(graph, Participant(1)), "/driver");
  EXPECT_FALSE(ForeignNodeOf(graph, Participant(2)));
  EXPECT_FALSE(ForeignNodeOf(graph, Participant(3)));
}

}  // namespace
}  // namespace rips::pipeline
