#include "services/ros2/gid_form.h"

#include <string>

#include "gtest/gtest.h"

namespace rips::ros2 {
namespace {

Guid ParticipantGuid(uint8_t number) {
  Guid guid;
  guid.bytes = {1, 0x10, number, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1, 0xc1};
  return guid;
}

TEST(GidFormOfTest, TellsTheFormsThatAreDecoded) {
  for (const GidBytes form : {GidBytes::k16, GidBytes::k24}) {
    ParticipantEntities info{.participant = ParticipantGuid(1), .gid_bytes = form};
    for (int nodes = 0; nodes < 3; ++nodes) {
      const std::string payload = EncodeParticipantEntities(info);
      const auto decoded = DecodeParticipantEntities(payload);
      ASSERT_TRUE(decoded.ok()) << decoded.status();
      EXPECT_EQ(decoded->gid_bytes, form);
      EXPECT_EQ(GidFormOf(payload), form) << nodes;
      info.nodes.push_back({.node_namespace = "/", .node_name = "n", .readers = {Guid{}}});
    }
  }
}

TEST(GidFormOfTest, ShortOnesAreNone) {
  const std::string payload = EncodeParticipantEntities(
      {.participant = ParticipantGuid(1), .nodes = {}, .gid_bytes = GidBytes::k16});
  ASSERT_EQ(payload.size(), 24u);
  for (size_t size = 0; size < payload.size(); ++size) {
    EXPECT_EQ(GidFormOf(payload.substr(0, size)), std::nullopt) << size;
  }
}

TEST(GidFormVotesTest, FollowsTheMajorityOfThoseWhoAreThere) {
  GidFormVotes votes(GidBytes::k24);
  EXPECT_EQ(votes.form(), GidBytes::k24);
  votes.Heard(ParticipantGuid(1), GidBytes::k16);
  EXPECT_EQ(votes.form(), GidBytes::k16) << "the only one";
  votes.Heard(ParticipantGuid(2), GidBytes::k24);
  EXPECT_EQ(votes.form(), GidBytes::k16) << "a tie changes nothing";
  votes.Heard(ParticipantGuid(3), GidBytes::k24);
  EXPECT_EQ(votes.form(), GidBytes::k24);
  votes.Heard(ParticipantGuid(3), GidBytes::k16);
  EXPECT_EQ(votes.form(), GidBytes::k16) << "its newest claim counts";
  votes.Gone(ParticipantGuid(1));
  votes.Gone(ParticipantGuid(1));
  votes.Gone(ParticipantGuid(3));
  EXPECT_EQ(votes.form(), GidBytes::k24);
  votes.Gone(ParticipantGuid(2));
  EXPECT_EQ(votes.form(), GidBytes::k24) << "nobody is left";
}

TEST(GidFormVotesTest, KeepsThoseWhoStay) {
  GidFormVotes votes(GidBytes::k24);
  for (uint8_t i = 1; i <= 5; ++i) votes.Heard(ParticipantGuid(i), GidBytes::k24);
  votes.Heard(ParticipantGuid(6), GidBytes::k16);
  EXPECT_EQ(votes.form(), GidBytes::k24);
  votes.Keep([](const Guid& participant) { return participant == ParticipantGuid(6); });
  EXPECT_EQ(votes.form(), GidBytes::k16);
}

TEST(GidFormVotesTest, AFloodOfParticipantsIsBounded) {
  GidFormVotes votes(GidBytes::k24);
  for (size_t i = 0; i < GidFormVotes::kVotersMax; ++i) {
    Guid guid = ParticipantGuid(1);
    guid.bytes[4] = static_cast<uint8_t>(i);
    guid.bytes[5] = static_cast<uint8_t>(i >> 8);
    votes.Heard(guid, i % 2 == 0 ? GidBytes::k24 : GidBytes::k16);
  }
  EXPECT_EQ(votes.form(), GidBytes::k24);
  votes.Heard(ParticipantGuid(200), GidBytes::k16);
  EXPECT_EQ(votes.form(), GidBytes::k24) << "one too many";
}

}  // namespace
}  // namespace rips::ros2
