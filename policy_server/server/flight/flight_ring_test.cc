#include "policy_server/server/flight/flight_ring.h"

#include <algorithm>
#include <memory>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"

namespace rips::flight {
namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;

class FlightRingTest : public ::testing::Test {
 protected:
  using Graph = std::shared_ptr<const ros2::RosGraph>;

  FlightRingTest() { Begin(); }
  static ros2::Guid ParticipantGuid() {
    ros2::Guid guid;
    guid.bytes = {1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1};
    return guid;
  }
  static Graph MakeGraph(int nodes) {
    auto graph = std::make_shared<ros2::RosGraph>(ros2::kWideGraphLimits);
    ros2::GraphDelta delta;
    const ros2::Guid guid = ParticipantGuid();
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
  static pipeline::GraphChange Change(const std::string& node) {
    pipeline::GraphChange change{.from_version = 1, .to_version = 2, .settled = true};
    change.delta.upsert_nodes.push_back({.full_name = node, .participant = ParticipantGuid()});
    return change;
  }
  // A batch with these changes has led to `graph`.
  std::shared_ptr<const pipeline::Batch> AddGraphOf(std::vector<pipeline::GraphChange> changes,
                                                    Graph graph) {
    auto batch = std::make_shared<pipeline::Batch>();
    for (auto& change : changes) batch->observations.push_back({.what = std::move(change)});
    ring_.Add({.event = {.what = engine::GraphEvent{}}, .graph = graph, .batch = batch});
    graph_ = std::move(graph);
    return batch;
  }
  // What `changes` make of the graph.
  Graph After(const std::vector<pipeline::GraphChange>& changes) const {
    auto graph = std::make_shared<ros2::RosGraph>(*graph_);
    for (const auto& change : changes) EXPECT_TRUE(graph->Apply(change.delta).ok());
    return graph;
  }
  // Of the event, which is a change of the graph.
  static const ros2::GraphDelta* DeltaOf(const FlightPiece& piece, size_t event) {
    for (const FlightOther& other : piece.others) {
      if (other.event != event) continue;
      return std::get<std::shared_ptr<const ros2::GraphDelta>>(other.what).get();
    }
    ADD_FAILURE() << "event " << event << " is a message";
    return nullptr;
  }
  // What a replay takes for the graph after the last event.
  static ros2::RosGraph Replayed(const Flight& flight) {
    ros2::RosGraph graph = *flight.front()->state.graph;
    for (const auto& piece : flight) {
      auto other = piece->others.begin();
      auto context = piece->contexts.begin();
      for (size_t i = 0; i < piece->events.size(); ++i) {
        if (context != piece->contexts.end() && context->event == i) graph = *context++->graph;
        if (piece->events[i].sender != nullptr) continue;
        EXPECT_EQ(other->event, i);
        const auto* delta = std::get_if<std::shared_ptr<const ros2::GraphDelta>>(&other++->what);
        if (delta != nullptr) {
          EXPECT_TRUE(graph.Apply(**delta).ok());
        }
      }
      EXPECT_TRUE(other == piece->others.end() && context == piece->contexts.end());
    }
    return graph;
  }
  static bool Same(const ros2::RosGraph& one, const ros2::RosGraph& other) {
    return ros2::RosGraph::Diff(one, other).empty();
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
  EXPECT_EQ(flight.back()->contexts.back().event, flight.back()->events.size() - 1);
}

TEST_F(FlightRingTest, AChangeOfTheGraphIsKeptAsADifference) {
  AddGraph(MakeGraph(3));
  AddMessage();
  const Flight flight = ring_.Take();
  ASSERT_THAT(flight.back()->events, SizeIs(2));
  const ros2::GraphDelta* delta = DeltaOf(*flight.back(), 0);
  ASSERT_THAT(delta->upsert_nodes, SizeIs(1));
  EXPECT_EQ(delta->upsert_nodes[0].full_name, "/n2");
  EXPECT_THAT(flight.back()->contexts, IsEmpty()) << "the graph as it is";
}

TEST_F(FlightRingTest, AChangeThatTheSensorToldIsKeptAsItCame) {
  const auto batch = AddGraphOf({Change("/a")}, After({Change("/a")}));
  const Flight flight = ring_.Take();
  const auto& told = std::get<pipeline::GraphChange>(batch->observations[0].what);
  EXPECT_EQ(DeltaOf(*flight.back(), 0), &told.delta) << "no copy";
  EXPECT_EQ(batch.use_count(), 3) << "the piece keeps it alive";
  EXPECT_TRUE(Same(Replayed(flight), *graph_));
}

TEST_F(FlightRingTest, ABatchOfSeveralChangesIsComparedWithTheGraphBefore) {
  const std::vector<pipeline::GraphChange> changes = {Change("/a"), Change("/b")};
  AddGraphOf(changes, After(changes));
  const Flight flight = ring_.Take();
  EXPECT_THAT(DeltaOf(*flight.back(), 0)->upsert_nodes, SizeIs(2));
  EXPECT_TRUE(Same(Replayed(flight), *graph_));
}

TEST_F(FlightRingTest, ASnapshotIsComparedWithTheGraphBefore) {
  pipeline::GraphChange whole = Change("/n0");
  whole.from_version = 0;
  whole.delta.upsert_participants.push_back({.guid = ParticipantGuid()});
  AddGraphOf({whole}, MakeGraph(1));
  const Flight flight = ring_.Take();
  EXPECT_THAT(DeltaOf(*flight.back(), 0)->gone_nodes, SizeIs(1)) << "/n1";
  EXPECT_TRUE(Same(Replayed(flight), *graph_));
}

TEST_F(FlightRingTest, ALargeChangeIsComparedSinceItMayBeNoNews) {
  pipeline::GraphChange change = Change("/a");
  for (size_t i = 0; i < FlightRing::kToldBytesMax / 100; ++i) {
    change.delta.gone_nodes.push_back(absl::StrCat("/gone", i));
  }
  AddGraphOf({change}, After({change}));
  EXPECT_LE(ring_.bytes(), FlightRing::kPieceBytes / 8);
  const Flight flight = ring_.Take();
  EXPECT_THAT(DeltaOf(*flight.back(), 0)->gone_nodes, IsEmpty());
  EXPECT_TRUE(Same(Replayed(flight), *graph_));
}

TEST_F(FlightRingTest, AGraphThatLeavesOutWhatItWasToldIsComparedWithTheGraphBefore) {
  ros2::GraphLimits limits;
  limits.nodes = 2;
  auto full = std::make_shared<ros2::RosGraph>(limits);
  ASSERT_TRUE(full->Apply(ros2::RosGraph::Diff(ros2::RosGraph(), *graph_)).ok());
  graph_ = full;
  Begin();
  const Graph after = After({Change("/a")});
  ASSERT_GT(after->dropped(), 0u);
  AddGraphOf({Change("/a")}, after);
  const Flight flight = ring_.Take();
  EXPECT_TRUE(DeltaOf(*flight.back(), 0)->truncation.has_value());
  EXPECT_TRUE(Same(Replayed(flight), *graph_));
}

TEST_F(FlightRingTest, AChangeAfterAMessageOfAnEarlierGraphLeadsToTheNewest) {
  const Graph before = graph_;
  AddGraphOf({Change("/a")}, After({Change("/a")}));
  AddMessage(0, before);
  AddGraphOf({Change("/b")}, After({Change("/b")}));
  AddMessage();
  const Flight flight = ring_.Take();
  ASSERT_THAT(flight.back()->events, SizeIs(4));
  ASSERT_THAT(flight.back()->contexts, SizeIs(1));
  EXPECT_EQ(flight.back()->contexts[0].event, 1u);
  EXPECT_EQ(flight.back()->contexts[0].graph, before);
  EXPECT_THAT(DeltaOf(*flight.back(), 2)->upsert_nodes, SizeIs(2)) << "/a and /b";
  EXPECT_TRUE(Same(Replayed(flight), *graph_));
}

TEST_F(FlightRingTest, ABatchIsCountedOnceInEachPiece) {
  constexpr size_t kMessages = 100;
  auto batch = std::make_shared<pipeline::Batch>();
  batch->payload_bytes = 100'000;
  batch->observations.resize(kMessages, {.what = pipeline::MessageSeen{.topic = "/t"}});
  const auto add = [&](size_t from, size_t to) {
    for (size_t i = from; i < to; ++i) {
      const auto& seen = std::get<pipeline::MessageSeen>(batch->observations[i].what);
      ring_.Add({.event = {.what = engine::MessageEvent{.topic = seen.topic}},
                 .graph = graph_,
                 .message = &seen,
                 .batch = batch});
      if (i % 10 == 0) AddMessage();  // of another batch
    }
  };
  add(0, kMessages / 2);
  EXPECT_GT(ring_.bytes(), 100'000u);
  EXPECT_LT(ring_.bytes(), 200'000u);
  Begin();
  add(kMessages / 2, kMessages);
  EXPECT_GT(ring_.bytes(), 200'000u) << "the older piece may go first";
  EXPECT_LT(ring_.bytes(), 300'000u);
  std::weak_ptr<const pipeline::Batch> kept = batch;
  batch.reset();
  const Flight flight = ring_.Take();
  EXPECT_EQ(Events(flight), kMessages + 10);
  EXPECT_FALSE(kept.expired());
}

TEST_F(FlightRingTest, SendersAreToldByTheirTextNotByItsPlace) {
  std::string place = "/a";
  const auto add = [&](const char* name) {
    place = name;
    ring_.Add({.event = {.what = engine::MessageEvent{.sender = place}}, .graph = graph_});
  };
  for (const char* name : {"/a", "/b", "", "/a", "/a/longer"}) add(name);
  Begin();
  add("/a/longer");
  place = "/gone";
  std::vector<std::string> senders;
  for (const auto& piece : ring_.Take()) {
    for (const FlightEvent& event : piece->events) senders.push_back(*event.sender);
  }
  EXPECT_THAT(senders, ElementsAre("/a", "/b", "", "/a", "/a/longer", "/a/longer"));
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
