#include "sensor_agent/outbox/graph_base.h"

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

ros2::Guid Participant(uint8_t n) {
  ros2::Guid guid;
  guid.bytes = {1, 0x10, n, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1};
  return guid;
}

GraphChange Step(uint64_t from, uint8_t n) {
  GraphChange change{.from_version = from, .to_version = from + 1, .settled = true};
  change.delta.upsert_participants.push_back({.guid = Participant(n)});
  change.delta.upsert_nodes.push_back(
      {.full_name = absl::StrCat("/n", n), .participant = Participant(n)});
  return change;
}

TEST(GraphBaseTest, IsNotKnownBeforeASnapshot) {
  GraphBase base;
  EXPECT_FALSE(base.Snapshot().has_value());
  base.Apply(Step(1, 1));
  EXPECT_FALSE(base.Snapshot().has_value());
}

TEST(GraphBaseTest, AddsUpWhatWasAcknowledged) {
  GraphBase base;
  base.Apply(Step(0, 1));
  base.Apply(Step(1, 2));
  const auto snapshot = base.Snapshot();
  ASSERT_TRUE(snapshot.has_value());
  EXPECT_EQ(snapshot->from_version, 0u);
  EXPECT_EQ(snapshot->to_version, 2u);
  EXPECT_TRUE(snapshot->settled);
  EXPECT_EQ(snapshot->delta.upsert_nodes.size(), 2u);

  const auto after = base.SnapshotAfter(Step(2, 3));
  ASSERT_TRUE(after.has_value());
  EXPECT_EQ(after->to_version, 3u);
  EXPECT_EQ(after->delta.upsert_nodes.size(), 3u);
  EXPECT_EQ(base.version(), 2u) << "it has not been acknowledged";
}

TEST(GraphBaseTest, AStepThatDoesNotFitMakesItUnknownUntilTheNextSnapshot) {
  GraphBase base;
  base.Apply(Step(0, 1));
  EXPECT_FALSE(base.SnapshotAfter(Step(5, 2)).has_value());
  base.Apply(Step(5, 2));
  EXPECT_FALSE(base.Snapshot().has_value());
  base.Apply(Step(0, 3));
  ASSERT_TRUE(base.Snapshot().has_value());
  EXPECT_EQ(base.Snapshot()->delta.upsert_nodes.size(), 1u);
  base.Forget();
  EXPECT_FALSE(base.Snapshot().has_value());
}

TEST(GraphBaseTest, AGraphThatIsTooLargeIsNotKnown) {
  GraphBase base;
  GraphChange large = Step(0, 1);
  for (int i = 0; i < 3'000; ++i) {
    ros2::Guid guid = Participant(1);
    guid.bytes[14] = static_cast<uint8_t>(i >> 8);
    guid.bytes[13] = static_cast<uint8_t>(i);
    guid.bytes[15] = 3;
    large.delta.upsert_endpoints.push_back({.guid = guid,
                                            .kind = ros2::EndpointKind::kPublisher,
                                            .name = absl::StrCat("/", std::string(600, 't'), i),
                                            .type = "a/msg/A",
                                            .node = "/n1"});
  }
  base.Apply(large);
  EXPECT_FALSE(base.Snapshot().has_value());
}

}  // namespace
}  // namespace rips::sensor
