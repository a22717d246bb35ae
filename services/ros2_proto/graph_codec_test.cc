#include "services/ros2_proto/graph_codec.h"

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::ros2_proto {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

ros2::Guid Participant() {
  return *ros2::GuidFromBytes("PARTICIPANT1" + std::string("\0\0\1\xc1", 4));
}
ros2::Guid EndpointGuid(char id) {
  return *ros2::GuidFromBytes("PARTICIPANT1" + std::string("\0\0", 2) + id + '\3');
}

// One of each kind, every field set.
ros2::GraphDelta Upserts() {
  ros2::GraphDelta delta;
  delta.upsert_participants.push_back({.guid = Participant(),
                                       .host = "robot",
                                       .enclave = "/e",
                                       .pid = 7,
                                       .vendor = "0110",
                                       .authenticated = true,
                                       .address = "10.0.0.66"});
  delta.upsert_nodes.push_back({.full_name = "/camera", .participant = Participant()});
  char id = 1;
  for (const auto kind : {ros2::EndpointKind::kPublisher, ros2::EndpointKind::kSubscriber,
                          ros2::EndpointKind::kService, ros2::EndpointKind::kClient}) {
    delta.upsert_endpoints.push_back({.guid = EndpointGuid(id),
                                      .kind = kind,
                                      .name = "/image",
                                      .type = "sensor_msgs/msg/Image",
                                      .node = id % 2 == 0 ? "" : "/camera",
                                      .pending = id == 2,
                                      .qos = {.reliable = true,
                                              .transient_local = true,
                                              .keep_all = id == 3,
                                              .depth = 5,
                                              .partitions = {"a", "b"}},
                                      .visibility = static_cast<ros2::Visibility>(id - 1),
                                      .why = "why",
                                      .ros = id != 4});
    ++id;
  }
  return delta;
}

void ExpectSameUpserts(const ros2::GraphDelta& left, const ros2::GraphDelta& right) {
  EXPECT_EQ(left.upsert_participants, right.upsert_participants);
  EXPECT_EQ(left.upsert_nodes, right.upsert_nodes);
  EXPECT_EQ(left.upsert_endpoints, right.upsert_endpoints);
}

TEST(GraphCodecTest, ASnapshotReadsBackAsItWasWritten) {
  rips::v1::GraphSnapshot wire;
  EncodeGraph(Upserts(), wire);

  const auto read = DecodeGraph(wire);

  ASSERT_THAT(read, IsOk());
  ExpectSameUpserts(*read, Upserts());
}

TEST(GraphCodecTest, ADeltaReadsBackAsItWasWritten) {
  ros2::GraphDelta delta = Upserts();
  delta.gone_guids = {EndpointGuid(9)};
  delta.gone_nodes = {"/gone"};
  rips::v1::GraphDelta wire;
  EncodeGraph(delta, wire);

  const auto read = DecodeGraph(wire);

  ASSERT_THAT(read, IsOk());
  ExpectSameUpserts(*read, delta);
  EXPECT_THAT(read->gone_guids, ElementsAre(EndpointGuid(9)));
  EXPECT_THAT(read->gone_nodes, ElementsAre("/gone"));
}

TEST(GraphCodecTest, AGraphReadsBackAsItWasWritten) {
  ros2::RosGraph graph;
  ASSERT_THAT(graph.Apply(Upserts()), IsOk());
  rips::v1::GraphSnapshot wire;
  EncodeGraph(graph, wire);

  const auto read = DecodeGraph(wire);

  ASSERT_THAT(read, IsOk());
  ros2::RosGraph copy;
  ASSERT_THAT(copy.Apply(*read), IsOk());
  EXPECT_EQ(copy.endpoints(), graph.endpoints());
  EXPECT_EQ(copy.nodes(), graph.nodes());
  EXPECT_EQ(copy.participants(), graph.participants());
}

TEST(GraphCodecTest, WhatIsLeftOutReadsBackAsItWasWritten) {
  const ros2::Truncation left_out{.left_out = 9,
                                  .crowds = {{EndpointGuid(1).Participant(), 2'048, 8}}};
  for (const std::optional<ros2::Truncation>& each :
       {std::optional<ros2::Truncation>(), std::optional(left_out),
        std::optional(ros2::Truncation{})}) {
    const ros2::GraphDelta delta{.truncation = each};
    rips::v1::GraphDelta wire;
    EncodeGraph(delta, wire);
    ASSERT_THAT(DecodeGraph(wire), IsOk());
    EXPECT_EQ(DecodeGraph(wire)->truncation, each);
    rips::v1::GraphSnapshot snapshot;
    EncodeGraph(delta, snapshot);
    ASSERT_THAT(DecodeGraph(snapshot), IsOk());
    EXPECT_EQ(DecodeGraph(snapshot)->truncation, each);
  }
  ros2::RosGraph graph({.endpoints = 1});
  ASSERT_THAT(graph.Apply(Upserts()), IsOk());
  ASSERT_TRUE(graph.truncated());
  rips::v1::GraphSnapshot wire;
  EncodeGraph(graph, wire);
  ASSERT_THAT(DecodeGraph(wire), IsOk());
  EXPECT_EQ(DecodeGraph(wire)->truncation, graph.truncation());
}

TEST(GraphCodecTest, RefusesWhatIsMalformed) {
  const auto invalid = absl::StatusCode::kInvalidArgument;
  rips::v1::GraphSnapshot good;
  EncodeGraph(Upserts(), good);
  rips::v1::GraphSnapshot wire = good;
  wire.mutable_participants(0)->set_guid("short");
  EXPECT_THAT(DecodeGraph(wire), StatusIs(invalid));
  wire = good;
  wire.mutable_nodes(0)->clear_participant_guid();
  EXPECT_THAT(DecodeGraph(wire), StatusIs(invalid));
  wire = good;
  wire.mutable_endpoints(0)->set_guid(std::string(17, 'x'));
  EXPECT_THAT(DecodeGraph(wire), StatusIs(invalid));
  wire = good;
  wire.mutable_endpoints(0)->clear_kind();
  EXPECT_THAT(DecodeGraph(wire), StatusIs(invalid, HasSubstr("kind 0")));
  rips::v1::GraphDelta delta;
  delta.add_gone_guids("short");
  EXPECT_THAT(DecodeGraph(delta), StatusIs(invalid));
  wire = good;
  wire.mutable_truncation()->add_crowds()->set_participant_guid("short");
  EXPECT_THAT(DecodeGraph(wire), StatusIs(invalid));
  wire = good;
  for (int i = 0; i < 9; ++i) {
    wire.mutable_truncation()->add_crowds()->set_participant_guid(std::string(16, 'p'));
  }
  EXPECT_THAT(DecodeGraph(wire), StatusIs(invalid, HasSubstr("9 crowds")));
}

TEST(GraphCodecTest, AVisibilityOfTheFutureIsUnspecified) {
  rips::v1::Endpoint wire;
  EncodeEndpoint(Upserts().upsert_endpoints[0], wire);
  wire.set_visibility(static_cast<rips::v1::Visibility>(77));

  const auto read = DecodeEndpoint(wire);

  ASSERT_THAT(read, IsOk());
  EXPECT_EQ(read->visibility, ros2::Visibility::kUnspecified);
}

}  // namespace
}  // namespace rips::ros2_proto
