#include "services/ros2/guid.h"

#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::ros2 {
namespace {

TEST(GuidTest, TextRoundTrip) {
  const std::string text = "01104a3b.00000000.000000ff.000003c1";
  const absl::StatusOr<Guid> guid = ParseGuid(text);
  ASSERT_THAT(guid, IsOk());
  EXPECT_EQ(guid->bytes[0], 0x01);
  EXPECT_EQ(guid->bytes[15], 0xc1);
  EXPECT_EQ(ToString(*guid), text);
}

TEST(GuidTest, ParseRefusesAnythingElse) {
  const std::string text = "01104a3b.00000000.000000ff.000003c1";
  for (size_t i = 0; i < text.size(); ++i) {
    EXPECT_THAT(ParseGuid(text.substr(0, i)), StatusIs(absl::StatusCode::kInvalidArgument)) << i;
    std::string changed = text;
    changed[i] = 'G';
    EXPECT_THAT(ParseGuid(changed), StatusIs(absl::StatusCode::kInvalidArgument)) << i;
  }
  EXPECT_THAT(ParseGuid(text + "0"), StatusIs(absl::StatusCode::kInvalidArgument));
  EXPECT_THAT(ParseGuid("01104A3B.00000000.000000ff.000003c1"),
              StatusIs(absl::StatusCode::kInvalidArgument));
}

TEST(GuidTest, BytesRoundTripAndRefuseOtherSizes) {
  const Guid guid = *ParseGuid("01104a3b.00000001.00000002.000003c1");
  EXPECT_EQ(*GuidFromBytes(guid.ToBytes()), guid);
  for (size_t size = 0; size <= 24; ++size) {
    EXPECT_EQ(GuidFromBytes(std::string(size, 'x')).ok(), size == 16) << size;
  }
}

TEST(GuidTest, ParticipantSharesThePrefix) {
  const Guid endpoint = *ParseGuid("01104a3b.00000001.00000002.00000403");
  const Guid participant = *ParseGuid("01104a3b.00000001.00000002.000001c1");
  EXPECT_EQ(endpoint.Participant(), participant);
  EXPECT_TRUE(endpoint.SamePrefix(participant));
  EXPECT_FALSE(endpoint.SamePrefix(*ParseGuid("01104a3b.00000001.00000003.00000403")));
  EXPECT_TRUE(Guid().none());
  EXPECT_FALSE(endpoint.none());
}

}  // namespace
}  // namespace rips::ros2
