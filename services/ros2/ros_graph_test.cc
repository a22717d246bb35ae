#include "services/ros2/ros_graph.h"

#include <algorithm>
#include <random>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::ros2 {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

Guid P(uint32_t participant) {
  Guid guid;
  guid.bytes[10] = static_cast<uint8_t>(participant >> 8);
  guid.bytes[11] = static_cast<uint8_t>(participant);
  return guid.Participant();
}

Guid E(uint32_t participant, uint32_t entity) {
  Guid guid = P(participant);
  guid.bytes[12] = 0;
  guid.bytes[13] = static_cast<uint8_t>(entity >> 8);
  guid.bytes[14] = static_cast<uint8_t>(entity);
  guid.bytes[15] = 0x03;
  return guid;
}

Endpoint Ep(Guid guid, EndpointKind kind, std::string name, std::string node,
            std::string type = "std_msgs/msg/String") {
  return {.guid = guid,
          .kind = kind,
          .name = std::move(name),
          .type = std::move(type),
          .node = std::move(node)};
}

constexpr EndpointKind kPub = EndpointKind::kPublisher;
constexpr EndpointKind kSub = EndpointKind::kSubscriber;
constexpr EndpointKind kSrv = EndpointKind::kService;

// Two participants, a node each: /a publishes /t and /u, /b subscribes to /t and serves /s.
GraphDelta TwoNodes() {
  return {
      .upsert_participants = {{.guid = P(1)}, {.guid = P(2)}},
      .upsert_nodes = {{"/a", P(1)}, {"/b", P(2)}},
      .upsert_endpoints = {Ep(E(1, 1), kPub, "/t", "/a"), Ep(E(1, 2), kPub, "/u", "/a"),
                           Ep(E(2, 1), kSub, "/t", "/b"), Ep(E(2, 2), kSrv, "/s", "/b", "p/srv/S"),
                           Ep(E(2, 3), kSrv, "/s", "/b", "p/srv/S")}};
}

RosGraph Built() {
  RosGraph graph;
  EXPECT_THAT(graph.Apply(TwoNodes()), IsOk());
  return graph;
}

bool Same(const RosGraph& a, const RosGraph& b) {
  if (a.topics().size() != b.topics().size()) return false;
  for (const auto& [name, topic] : a.topics()) {
    const Topic* other = b.FindTopic(name);
    if (other == nullptr || other->publishers != topic.publishers ||
        other->subscribers != topic.subscribers || other->types != topic.types) {
      return false;
    }
  }
  return a.participants() == b.participants() && a.nodes() == b.nodes() &&
         a.endpoints() == b.endpoints();
}

TEST(RosGraphTest, AnswersAboutTopicsAndServices) {
  const RosGraph graph = Built();
  ASSERT_NE(graph.FindTopic("/t"), nullptr);
  EXPECT_THAT(graph.FindTopic("/t")->publishers, ElementsAre("/a"));
  EXPECT_THAT(graph.FindTopic("/t")->subscribers, ElementsAre("/b"));
  EXPECT_THAT(graph.FindTopic("/t")->types, ElementsAre("std_msgs/msg/String"));
  EXPECT_THAT(graph.FindTopic("/u")->subscribers, IsEmpty());
  EXPECT_EQ(graph.FindTopic("/s"), nullptr);
  // A service is two endpoints and one answer.
  EXPECT_THAT(graph.ServicesOf("/b"), ElementsAre("/s"));
  EXPECT_THAT(graph.ServicesOf("/a"), IsEmpty());
  EXPECT_THAT(graph.ServicesOf(""), IsEmpty());
  EXPECT_EQ(graph.FindEndpoint(E(1, 1))->name, "/t");
  EXPECT_EQ(graph.FindEndpoint(E(1, 9)), nullptr);
}

TEST(RosGraphTest, OneEntryPerEndpointAndTypesOnce) {
  RosGraph graph = Built();
  GraphDelta delta;
  delta.upsert_endpoints = {Ep(E(1, 3), kPub, "/t", "/a"),
                            Ep(E(2, 9), kPub, "/t", "/b", "std_msgs/msg/Int32")};
  ASSERT_THAT(graph.Apply(delta), IsOk());
  EXPECT_THAT(graph.FindTopic("/t")->publishers, ElementsAre("/a", "/a", "/b"));
  EXPECT_THAT(graph.FindTopic("/t")->types,
              ElementsAre("std_msgs/msg/Int32", "std_msgs/msg/String"));
  ASSERT_THAT(graph.Apply({.gone_guids = {E(1, 3), E(2, 9)}}), IsOk());
  EXPECT_TRUE(Same(graph, Built()));
}

TEST(RosGraphTest, UnattributedPendingAndForeignEndpoints) {
  RosGraph graph = Built();
  Endpoint unattributed = Ep(E(2, 7), kPub, "/t", "");
  Endpoint pending = Ep(E(2, 8), kPub, "/t", "");
  pending.pending = true;
  Endpoint foreign = Ep(E(2, 9), kPub, "/t", "");
  foreign.ros = false;
  ASSERT_THAT(graph.Apply({.upsert_endpoints = {unattributed, pending, foreign}}), IsOk());
  const std::string label = absl::StrCat("(unattributed ", ToString(E(2, 7)), ")");
  EXPECT_THAT(graph.FindTopic("/t")->publishers, ElementsAre(label, "/a"));
  EXPECT_EQ(graph.endpoints().size(), 8u);
  // Attribution arrives: the same endpoint now stands under its node.
  unattributed.node = "/b";
  pending.pending = false;
  ASSERT_THAT(graph.Apply({.upsert_endpoints = {unattributed, pending}}), IsOk());
  EXPECT_THAT(graph.FindTopic("/t")->publishers,
              ElementsAre(absl::StrCat("(unattributed ", ToString(E(2, 8)), ")"), "/a", "/b"));
}

TEST(RosGraphTest, AParticipantTakesItsNodesAndEndpointsAlong) {
  RosGraph graph = Built();
  ASSERT_THAT(graph.Apply({.gone_guids = {P(1)}}), IsOk());
  EXPECT_EQ(graph.nodes().size(), 1u);
  EXPECT_EQ(graph.endpoints().size(), 3u);
  EXPECT_EQ(graph.FindTopic("/u"), nullptr);
  EXPECT_THAT(graph.FindTopic("/t")->publishers, IsEmpty());
  ASSERT_THAT(graph.Apply({.gone_guids = {P(2), P(2), P(77), E(9, 9)}}), IsOk());
  EXPECT_TRUE(graph.topics().empty());
  EXPECT_THAT(graph.ServicesOf("/b"), IsEmpty());
}

TEST(RosGraphTest, ANodeNameOfTwoParticipants) {
  RosGraph graph = Built();
  GraphDelta twin;
  twin.upsert_nodes = {{"/a", P(2)}};
  twin.upsert_endpoints = {Ep(E(2, 4), kSrv, "/a/x", "/a", "p/srv/S")};
  ASSERT_THAT(graph.Apply(twin), IsOk());
  EXPECT_EQ(graph.nodes().size(), 3u);
  EXPECT_THAT(graph.ServicesOf("/a"), ElementsAre("/a/x"));
  // All of that name go; the survivor is named again.
  ASSERT_THAT(
      graph.Apply({.upsert_nodes = {{"/a", P(1)}}, .gone_guids = {E(2, 4)}, .gone_nodes = {"/a"}}),
      IsOk());
  EXPECT_TRUE(Same(graph, Built()));
}

TEST(RosGraphTest, ABadDeltaChangesNothing) {
  const Endpoint good = Ep(E(1, 5), kPub, "/new", "/a");
  const auto with = [&](Endpoint bad) {
    return GraphDelta{.upsert_endpoints = {good, std::move(bad)}};
  };
  Endpoint foreign = Ep(E(1, 6), kPub, std::string("x\ny"), "");
  foreign.ros = false;
  const std::pair<GraphDelta, const char*> cases[] = {
      {{.upsert_nodes = {{"/c", P(3)}}}, "unknown participant"},
      {{.upsert_nodes = {{"c", P(1)}}}, "not a valid node name"},
      {{.upsert_participants = {{.guid = E(1, 1)}}}, "not a participant"},
      {with(Ep(E(3, 1), kPub, "/t", "")), "unknown participant"},
      {with(Ep(P(1), kPub, "/t", "/a")), "not an endpoint"},
      {with(Ep(E(1, 6), kPub, "/t", "/b")), "unknown node `/b`"},
      {with(Ep(E(1, 6), kPub, "/t", "/nobody")), "unknown node"},
      {with(Ep(E(1, 6), kPub, "t", "/a")), "not a valid ROS name"},
      {with(Ep(E(1, 6), kPub, "/t", "/a", "")), "empty type"},
      {with(Ep(E(1, 6), kPub, "/t", "/a", std::string(513, 'x'))), "exceeds limit 512"},
      {with(foreign), "not printable"},
      // What goes is gone before what comes.
      {{.upsert_endpoints = {good}, .gone_guids = {P(1)}}, "unknown participant"},
      {{.upsert_endpoints = {good}, .gone_nodes = {"/a"}}, "unknown node"},
      // The node's endpoints would dangle.
      {{.gone_nodes = {"/a"}}, "would outlive it"},
      {{.gone_guids = {E(1, 1)}, .gone_nodes = {"/a"}}, "would outlive it"},
  };
  for (const auto& [delta, message] : cases) {
    RosGraph graph = Built();
    EXPECT_THAT(graph.Apply(delta),
                StatusIs(absl::StatusCode::kInvalidArgument, HasSubstr(message)));
    EXPECT_TRUE(Same(graph, Built())) << message;
    EXPECT_FALSE(graph.truncated());
  }
}

TEST(RosGraphTest, ANodeMayGoWithItsEndpoints) {
  RosGraph graph = Built();
  ASSERT_THAT(graph.Apply({.gone_guids = {E(1, 1), E(1, 2)}, .gone_nodes = {"/a"}}), IsOk());
  EXPECT_EQ(graph.nodes().size(), 1u);
  graph = Built();
  ASSERT_THAT(
      graph.Apply({.upsert_endpoints = {Ep(E(1, 1), kPub, "/t", ""), Ep(E(1, 2), kPub, "/u", "")},
                   .gone_nodes = {"/a"}}),
      IsOk());
  EXPECT_EQ(graph.endpoints().size(), 5u);
}

TEST(RosGraphTest, LimitsDropTheExcessAndSaySo) {
  RosGraph graph({.topics = 1, .nodes = 2, .endpoints = 100});
  ASSERT_THAT(graph.Apply(TwoNodes()), IsOk());
  EXPECT_TRUE(graph.truncated());
  EXPECT_EQ(graph.dropped(), 1u);  // /u
  EXPECT_EQ(graph.topics().size(), 1u);
  // A third node, and what refers to it.
  ASSERT_THAT(graph.Apply({.upsert_nodes = {{"/c", P(1)}},
                           .upsert_endpoints = {Ep(E(1, 8), kSrv, "/c/s", "/c", "p/srv/S")}}),
              IsOk());
  EXPECT_EQ(graph.dropped(), 3u);
  EXPECT_EQ(graph.nodes().size(), 2u);
  EXPECT_THAT(graph.ServicesOf("/c"), IsEmpty());
  // Room does not heal it: what was left out is not known to be complete.
  ASSERT_THAT(graph.Apply({.gone_guids = {P(1)}}), IsOk());
  EXPECT_TRUE(graph.truncated());
  graph.Clear();
  EXPECT_FALSE(graph.truncated());
  EXPECT_TRUE(graph.participants().empty() && graph.topics().empty());
}

TEST(RosGraphTest, EndpointAndParticipantLimits) {
  RosGraph few({.endpoints = 2});
  ASSERT_THAT(few.Apply(TwoNodes()), IsOk());
  EXPECT_EQ(few.endpoints().size(), 2u);
  EXPECT_EQ(few.dropped(), 3u);
  // An endpoint that is there may change at the limit.
  ASSERT_THAT(few.Apply({.upsert_endpoints = {Ep(E(1, 1), kPub, "/v", "/a")}}), IsOk());
  EXPECT_EQ(few.dropped(), 3u);
  EXPECT_NE(few.FindTopic("/v"), nullptr);

  RosGraph one({.participants = 1});
  ASSERT_THAT(one.Apply(TwoNodes()), IsOk());
  EXPECT_EQ(one.participants().size(), 1u);
  EXPECT_EQ(one.nodes().size(), 1u);
  EXPECT_EQ(one.endpoints().size(), 2u);
  EXPECT_EQ(one.dropped(), 5u);
}

TEST(RosGraphTest, EndpointsOfATruncatedGraphOutliveTheirNode) {
  RosGraph graph({.nodes = 2});
  ASSERT_THAT(graph.Apply(TwoNodes()), IsOk());
  // /a goes, /c takes its place, so /a finds no room when it is named again.
  ASSERT_THAT(graph.Apply({.upsert_nodes = {{"/c", P(1)}, {"/a", P(1)}}, .gone_nodes = {"/a"}}),
              IsOk());
  EXPECT_TRUE(graph.truncated());
  EXPECT_EQ(graph.dropped(), 3u) << "the node, and whose its two endpoints are";
  EXPECT_EQ(graph.endpoints().size(), 5u);
  EXPECT_THAT(graph.FindTopic("/u")->publishers, ElementsAre(HasSubstr("unattributed")));
}

// A random graph of up to 4 participants; valid by construction.
GraphDelta RandomWhole(std::mt19937& random) {
  GraphDelta whole;
  for (uint32_t p = 1; p <= 4; ++p) {
    if (random() % 4 == 0) continue;
    whole.upsert_participants.push_back({.guid = P(p), .pid = static_cast<uint32_t>(random() % 2)});
    std::vector<std::string> nodes = {""};
    for (const char* name : {"/n", "/m"}) {
      if (random() % 2 == 0) continue;
      whole.upsert_nodes.push_back({name, P(p)});
      nodes.push_back(name);
    }
    for (uint32_t e = 1; e <= 6; ++e) {
      if (random() % 2 == 0) continue;
      Endpoint endpoint =
          Ep(E(p, e), static_cast<EndpointKind>(random() % 4), absl::StrCat("/t", random() % 3),
             nodes[random() % nodes.size()], random() % 2 == 0 ? "p/msg/A" : "p/msg/B");
      endpoint.pending = random() % 5 == 0;
      endpoint.ros = random() % 5 != 0;
      whole.upsert_endpoints.push_back(endpoint);
    }
  }
  return whole;
}

TEST(RosGraphTest, DiffTurnsOneGraphIntoTheOther) {
  std::mt19937 random(7);
  for (int round = 0; round < 500; ++round) {
    RosGraph from;
    RosGraph to;
    ASSERT_THAT(from.Apply(RandomWhole(random)), IsOk());
    ASSERT_THAT(to.Apply(RandomWhole(random)), IsOk());
    RosGraph changed = from;
    ASSERT_THAT(changed.Apply(RosGraph::Diff(from, to)), IsOk()) << round;
    // The index kept step by step equals one built at once.
    EXPECT_TRUE(Same(changed, to)) << round;
    EXPECT_TRUE(RosGraph::Diff(changed, to).empty()) << round;
    for (const char* node : {"/n", "/m"}) {
      EXPECT_EQ(changed.ServicesOf(node), to.ServicesOf(node)) << round;
    }
    // Taking everything away leaves nothing behind.
    ASSERT_THAT(changed.Apply(RosGraph::Diff(changed, RosGraph())), IsOk());
    EXPECT_TRUE(Same(changed, RosGraph())) << round;
  }
}

TEST(NodeNameMatchesTest, Table) {
  EXPECT_TRUE(NodeNameMatches("/ns/n", "/ns/n"));
  EXPECT_FALSE(NodeNameMatches("/n", "/ns/n"));
  EXPECT_TRUE(NodeNameMatches("n", "/ns/n"));
  EXPECT_TRUE(NodeNameMatches("n", "/n"));
  EXPECT_FALSE(NodeNameMatches("n", "/ns/nn"));
  EXPECT_FALSE(NodeNameMatches("", "/n"));
  EXPECT_FALSE(NodeNameMatches("ns/n", "/ns/n"));
}

}  // namespace
}  // namespace rips::ros2
