#include "sensor_agent/graph/own_participants.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

ros2::Guid ParticipantGuid(uint8_t number) {
  ros2::Guid guid;
  guid.bytes = {1, 0x10, number, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1, 0xc1};
  return guid;
}
const ros2::Guid kFirst = ParticipantGuid(1);
const ros2::Guid kSecond = ParticipantGuid(2);

TEST(OwnParticipantsTest, AreThoseThatTheServerNames) {
  OwnParticipants own;
  EXPECT_THAT(own.known(), IsEmpty());
  EXPECT_TRUE(own.Told({kSecond, kFirst}));
  EXPECT_THAT(own.known(), ElementsAre(kFirst, kSecond));
  EXPECT_FALSE(own.Told({kFirst, kSecond}));
}

TEST(OwnParticipantsTest, StayAlthoughTheServerForgets) {
  OwnParticipants own;
  own.Told({kFirst, kSecond});
  EXPECT_FALSE(own.Told({})) << "it was started again";
  EXPECT_THAT(own.known(), ElementsAre(kFirst, kSecond));
  EXPECT_FALSE(own.Told({kSecond}));
  EXPECT_FALSE(own.Told({kFirst, kSecond}));
  EXPECT_THAT(own.known(), ElementsAre(kFirst, kSecond));
}

TEST(OwnParticipantsTest, OnlySoManyAreKeptThatTheServerForgot) {
  OwnParticipants own;
  for (int i = 0; i < 200; ++i) own.Told({ParticipantGuid(static_cast<uint8_t>(i))});
  EXPECT_THAT(own.known(), SizeIs(OwnParticipants::kFormerMax + 1));
  EXPECT_EQ(own.known().back(), ParticipantGuid(199));
  EXPECT_EQ(own.known().front(), ParticipantGuid(199 - OwnParticipants::kFormerMax));
}

}  // namespace
}  // namespace rips::sensor
