#include "policy_server/ingest/interest_codec.h"

#include "gmock/gmock.h"

namespace rips::ingest {
namespace {

using ::testing::SizeIs;

TEST(InterestCodecTest, PayloadsFirstThenMetadataOfTheRest) {
  const rips::v1::Interest interest =
      EncodeInterest({{.topic_regex = "^/a$", .payload_bytes_max = 7},
                      {.topic_regex = "b", .payload_bytes_max = 9}});
  ASSERT_THAT(interest.rules(), SizeIs(3));
  EXPECT_EQ(interest.rules(0).topic_regex(), "^/a$");
  EXPECT_EQ(interest.rules(0).depth(), rips::v1::InterestRule::PAYLOAD);
  EXPECT_EQ(interest.rules(0).payload_bytes_max(), 7);
  EXPECT_EQ(interest.rules(1).payload_bytes_max(), 9);
  EXPECT_EQ(interest.rules(2).topic_regex(), "");
  EXPECT_EQ(interest.rules(2).type(), "");
  EXPECT_EQ(interest.rules(2).depth(), rips::v1::InterestRule::METADATA);
}

TEST(InterestCodecTest, TheIdTellsInterestsApart) {
  const std::string none = EncodeInterest({}).id();
  EXPECT_THAT(none, SizeIs(32));
  EXPECT_EQ(EncodeInterest({}).id(), none);
  const std::string all = EncodeInterest({{.payload_bytes_max = 1}}).id();
  EXPECT_NE(all, none);
  EXPECT_NE(EncodeInterest({{.payload_bytes_max = 2}}).id(), all);
  EXPECT_NE(EncodeInterest({{.topic_regex = "a", .payload_bytes_max = 1}}).id(), all);
}

}  // namespace
}  // namespace rips::ingest
