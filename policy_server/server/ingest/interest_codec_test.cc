#include "policy_server/server/ingest/interest_codec.h"

#include "gmock/gmock.h"

namespace rips::ingest {
namespace {

using ::testing::SizeIs;

using engine::Depth;

TEST(InterestCodecTest, RowsInTheirOrder) {
  const rips::v1::Interest interest =
      EncodeInterest({{.topic_regex = "^/a$", .depth = Depth::kPayload, .payload_bytes_max = 7},
                      {.topic_regex = "b", .depth = Depth::kPayload, .payload_bytes_max = 9},
                      {.depth = Depth::kMetadata}});
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
  const auto id = [](engine::TopicInterest row) { return EncodeInterest({std::move(row)}).id(); };
  const std::string all = id({.depth = Depth::kPayload, .payload_bytes_max = 1});
  EXPECT_NE(all, none);
  EXPECT_NE(id({.depth = Depth::kPayload, .payload_bytes_max = 2}), all);
  EXPECT_NE(id({.topic_regex = "a", .depth = Depth::kPayload, .payload_bytes_max = 1}), all);
  EXPECT_NE(id({.depth = Depth::kMetadata}), id({.depth = Depth::kNothing}));
  const engine::PayloadLimits limits = {{.topic_regex = "^/camera", .bytes = 2'000'000}};
  EXPECT_NE(EncodeInterest({}, limits).id(), none);
  const rips::v1::Interest kept = EncodeInterest({}, {}, {"/b", "/c", "/a"});
  EXPECT_NE(kept.id(), none);
  EXPECT_THAT(kept.kept_topics(), testing::ElementsAre("/a", "/b", "/c"));
  EXPECT_EQ(EncodeInterest({}, limits).payload_limits(0).topic_regex(), "^/camera");
  EXPECT_EQ(EncodeInterest({}, limits).payload_limits(0).bytes(), 2'000'000);
  EXPECT_EQ(id({.wanted_by = {"r"}}), id({})) << "reasons are not sent";
}

}  // namespace
}  // namespace rips::ingest
