#include "policy_server/server/flight/flight_ring.h"

#include <algorithm>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"

namespace rips::flight {
namespace {

using ::testing::IsNull;
using ::testing::NotNull;
using ::testing::SizeIs;

class FlightRingTest : public ::testing::Test {
 protected:
  using Graph = std::shared_ptr<const ros2::RosGraph>;

  FlightRingTest() { Begin(); }
  static Graph MakeGraph(int nodes) {
    auto graph = std::make_shared<ros2::RosGraph>(ros2::kWideGraphLimits);
    ros2::GraphDelta delta;
    ros2::Guid guid;
    guid.bytes = {1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1};
    delta.upsert_participants.push_back({.guid = guid});
    for (int i = 0; i < nodes; ++i) {
      delta.upsert_nodes.push_back({.full_name = absl::StrCat("/n", i), .participant = guid});
    }
    EXPECT_TRUE(graph->Apply(delta).ok());
    return graph;
  }
  void Begin(const std::string& bundle = "b1") {
    ring_.Begin({.bundle_id = bundle, .level = "DEFAULT", .graph = graph_, .settled = true},
                {.boottime_ns = now_ns_});
  }
  // Begins a piece when one is due, as the robot does between two inputs.
  void Pass(int64_t ns) {
    now_ns_ += ns;
    if (ring_.wants_piece({.boottime_ns = now_ns_})) Begin();
  }
  void AddMessage(size_t payload_bytes = 0, Graph graph = nullptr) {
    auto batch = std::make_shared<pipeline::Batch>();
    batch->observations.push_back(
        {.what = pipeline::MessageSeen{.topic = "/cmd_vel",
                                       .type = "geometry_msgs/msg/Twist",
                                       .payload = std::string(payload_bytes, 'x')}});
    batch->payload_bytes = payload_bytes;
    const auto& seen = std::get<pipeline::MessageSeen>(batch->observations[0].what);
    ring_.Add({.event = {.what =
                             engine::MessageEvent{
                                 .topic = seen.topic, .type = seen.type, .sender = "/teleop"},
                         .time_unix_ns = now_ns_},
               .graph = graph == nullptr ? graph_ : std::move(graph),
               .message = &seen,
               .batch = batch});
    if (ring_.wants_piece({.boottime_ns = now_ns_})) Begin();
  }
  void AddGraph(Graph graph) {
    ring_.Add({.event = {.what = engine::GraphEvent{}}, .graph = graph});
    graph_ = std::move(graph);
  }
  static size_t Events(const Flight& flight) {
    size_t events = 0;
    for (const auto& piece : flight) events += piece->events.size();
    return events;
  }

  FlightRing ring_;
  Graph graph_ = MakeGraph(2);
  int64_t now_ns_ = 0;
};

TEST_F(FlightRingTest, KeepsTheLastThirtySeconds) {
  for (int second = 0; second < 100; ++second) {
    AddMessage();
    Pass(kNanosPerSecond);
  }
  const Flight flight = ring_.Take();
  const int64_t span_ns = now_ns_ - flight.front()->events.front().time_unix_ns;
  EXPECT_GE(span_ns, FlightRing::kSpanNs);
  EXPECT_LE(span_ns, FlightRing::kSpanNs + 2 * FlightRing::kPieceNs);
  EXPECT_EQ(flight.front()->state.level, "DEFAULT");
}

TEST_F(FlightRingTest, IsBoundedWhateverComes) {
  size_t most = 0;
  for (int i = 0; i < 2'000; ++i) {
    AddMessage(i % 7 == 0 ? 60'000 : 100);
    most = std::max(most, ring_.bytes());
  }
  EXPECT_LE(most, FlightRing::kBytesMax + 2 * FlightRing::kPieceBytes);
  EXPECT_GT(most, FlightRing::kBytesMax / 2);
  EXPECT_GT(Events(ring_.Take()), 100u);
}

TEST_F(FlightRingTest, AGraphThatGoesBackAndForthCountsEachTime) {
  const Graph large = MakeGraph(1'000);
  const Graph small = graph_;
  for (int i = 0; i < 1'000; ++i) AddMessage(0, i % 2 == 0 ? large : small);
  EXPECT_LE(ring_.bytes(), FlightRing::kBytesMax + 2 * BytesOf(*large));
  const Flight flight = ring_.Take();
  EXPECT_LT(Events(flight) / 2 * BytesOf(*large), FlightRing::kBytesMax) << "with their graphs";
  EXPECT_THAT(flight.back()->events.back().context, NotNull());
}

TEST_F(FlightRingTest, AChangeOfTheGraphIsKeptAsADifference) {
  AddGraph(MakeGraph(3));
  AddMessage();
  const Flight flight = ring_.Take();
  ASSERT_THAT(flight.back()->events, SizeIs(2));
  const auto& delta =
      std::get<std::unique_ptr<const ros2::GraphDelta>>(flight.back()->events[0].what);
  ASSERT_THAT(delta->upsert_nodes, SizeIs(1));
  EXPECT_EQ(delta->upsert_nodes[0].full_name, "/n2");
  EXPECT_THAT(flight.back()->events[1].context, IsNull()) << "the graph as it is";
}

TEST_F(FlightRingTest, TheGraphAtTheStartCounts) {
  AddGraph(MakeGraph(30'000));
  for (int i = 0; i < 100; ++i) {
    AddMessage();
    Pass(kNanosPerSecond);
  }
  ASSERT_GT(BytesOf(*graph_), FlightRing::kBytesMax / 4);
  EXPECT_LE(ring_.bytes(),
            std::max(FlightRing::kBytesMax, BytesOf(*graph_)) + FlightRing::kPieceBytes);
}

TEST_F(FlightRingTest, AnotherBundleDropsWhatItDidNotJudge) {
  AddMessage();
  Begin("b2");
  AddMessage();
  const Flight flight = ring_.Take();
  EXPECT_EQ(Events(flight), 1u);
  EXPECT_EQ(flight.front()->state.bundle_id, "b2");
}

TEST_F(FlightRingTest, WhatWasTakenDoesNotChange) {
  AddMessage();
  const Flight flight = ring_.Take();
  EXPECT_TRUE(ring_.wants_piece({.boottime_ns = now_ns_}));
  Begin();
  AddMessage();
  EXPECT_EQ(Events(flight), 1u);
  EXPECT_EQ(Events(ring_.Take()), 2u) << "the newer one holds the older";
}

TEST_F(FlightRingTest, QuietTimesLeaveNoPieces) {
  for (int i = 0; i < 1'000; ++i) Pass(FlightRing::kPieceNs);
  EXPECT_THAT(ring_.Take(), SizeIs(1));
}

}  // namespace
}  // namespace rips::flight
