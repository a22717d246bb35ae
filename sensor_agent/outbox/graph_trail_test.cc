#include "sensor_agent/outbox/graph_trail.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"

namespace rips::sensor {
namespace {

// Version `to`, which shows one node more than the one before.
GraphChange Step(uint64_t to, size_t bytes = 0) {
  GraphChange change{.from_version = to - 1, .to_version = to, .settled = true};
  ros2::Guid participant;
  participant.bytes = {1,
                       0x10,
                       static_cast<uint8_t>(to),
                       static_cast<uint8_t>(to >> 8),
                       0,
                       0,
                       0,
                       0,
                       0,
                       0,
                       0,
                       0,
                       0,
                       0,
                       1,
                       0xc1};
  change.delta.upsert_participants.push_back(
      {.guid = participant, .host = std::string(bytes, 'x')});
  change.delta.upsert_nodes.push_back(
      {.full_name = absl::StrCat("/n", to), .participant = participant});
  return change;
}

size_t Nodes(const std::vector<GraphChange>& brought) {
  ros2::RosGraph graph(ros2::kWideGraphLimits);
  for (const GraphChange& step : brought) EXPECT_TRUE(graph.Apply(step.delta).ok());
  return graph.nodes().size();
}

TEST(GraphTrailTest, TheFirstBatchBringsTheGraphOfItsTime) {
  GraphTrail trail;
  for (uint64_t version = 1; version <= 3; ++version) trail.Add(Step(version));
  GraphTrail::Brought brought;
  const auto whole = trail.Bring(2, brought);
  ASSERT_EQ(whole.size(), 1u);
  EXPECT_TRUE(whole[0].whole());
  EXPECT_EQ(whole[0].to_version, 2u);
  EXPECT_EQ(Nodes(whole), 2u);
  EXPECT_TRUE(trail.Bring(2, brought).empty()) << "it is there";
}

TEST(GraphTrailTest, LaterBatchesBringTheStepsBetween) {
  GraphTrail trail;
  for (uint64_t version = 1; version <= 5; ++version) trail.Add(Step(version));
  GraphTrail::Brought brought;
  trail.Bring(2, brought);
  const auto steps = trail.Bring(4, brought);
  ASSERT_EQ(steps.size(), 2u);
  EXPECT_EQ(steps[0].from_version, 2u);
  EXPECT_EQ(steps[1].to_version, 4u);
  EXPECT_TRUE(trail.Bring(3, brought).empty()) << "a later one shows who is still there";
  EXPECT_EQ(trail.Bring(9, brought).back().to_version, 5u) << "9 is not known yet";
}

TEST(GraphTrailTest, AfterManyBatchesASnapshotIsBroughtAgain) {
  GraphTrail trail;
  trail.Add(Step(1));
  GraphTrail::Brought brought;
  int snapshots = 0;
  for (int i = 0; i < 3 * GraphTrail::kBatchesMax; ++i) {
    snapshots += trail.Bring(1, brought).empty() ? 0 : 1;
  }
  EXPECT_EQ(snapshots, 3);
}

TEST(GraphTrailTest, StepsOlderThanAllMessagesBecomePartOfTheBase) {
  GraphTrail trail;
  for (uint64_t version = 1; version <= 5; ++version) trail.Add(Step(version));
  trail.Advance(3);
  GraphTrail::Brought brought;
  EXPECT_EQ(trail.Bring(1, brought).back().to_version, 3u) << "the oldest that is known";
  EXPECT_EQ(Nodes(trail.Bring(4, brought)), 1u);
  brought = {.version = 1, .batches = 1};
  EXPECT_TRUE(trail.Bring(5, brought)[0].whole()) << "the steps from 1 on are not held";
}

TEST(GraphTrailTest, AnUnknownGraphBringsNothing) {
  GraphTrail trail;
  GraphTrail::Brought brought;
  EXPECT_TRUE(trail.Bring(1, brought).empty());
  trail.Add(Step(7));
  EXPECT_TRUE(trail.Bring(7, brought).empty()) << "what it follows was not seen";
  trail.Clear();
  trail.Add(Step(1));
  EXPECT_TRUE(trail.Bring(0, brought).empty()) << "the message names no version";
  EXPECT_FALSE(trail.Bring(1, brought).empty());
  trail.Clear();
  EXPECT_TRUE(trail.Bring(2, brought).empty());
}

TEST(GraphTrailTest, AGraphThatIsTooLargeIsLeftOutAndWhatIsHeldHasALimit) {
  GraphTrail trail;
  GraphTrail::Brought brought;
  const size_t large = GraphTrail::kBroughtBytesMax / 4;
  for (uint64_t version = 1; version <= 3; ++version) trail.Add(Step(version, large));
  EXPECT_FALSE(trail.Bring(3, brought).empty());
  for (uint64_t version = 4; version <= 8; ++version) trail.Add(Step(version, large));
  EXPECT_TRUE(trail.Bring(8, brought).empty());
  brought = {};
  EXPECT_TRUE(trail.Bring(8, brought).empty());
  for (uint64_t version = 9; version <= 2 * GraphTrail::kStepsMax; ++version) {
    trail.Add(Step(version));
  }
  EXPECT_TRUE(trail.Bring(1, brought).empty()) << "its oldest graph is too large";
}

}  // namespace
}  // namespace rips::sensor
