#include "policy_server/server/robot/sight/graph_health.h"

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/model/dds_problem.h"

namespace rips::pipeline {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

ros2::Guid ParticipantGuid(uint8_t n) {
  ros2::Guid guid;
  guid.bytes = {1, 0x10, n, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0xc1};
  return guid;
}

ros2::Guid EndpointGuid(uint8_t n, uint8_t number) {
  ros2::Guid guid = ParticipantGuid(n);
  guid.bytes[14] = number;
  guid.bytes[15] = 3;
  return guid;
}

class GraphHealthTest : public testing::Test {
 protected:
  GraphHealthTest() {
    // The sensor itself, as it is in every graph.
    Node(1, "/rips");
    Add(1, ros2::EndpointKind::kSubscriber, "/chatter", "/rips");
  }
  void Node(uint8_t n, const std::string& name) {
    content_.upsert_participants.push_back({.guid = ParticipantGuid(n)});
    content_.upsert_nodes.push_back({.full_name = name, .participant = ParticipantGuid(n)});
  }
  ros2::Endpoint& Add(uint8_t n, ros2::EndpointKind kind, const std::string& name,
                      const std::string& node) {
    return content_.upsert_endpoints.emplace_back(ros2::Endpoint{.guid = EndpointGuid(n, ++count_),
                                                                 .kind = kind,
                                                                 .name = name,
                                                                 .type = "a/msg/B",
                                                                 .node = node});
  }
  ros2::RosGraph Graph(ros2::GraphLimits limits = {}) {
    ros2::RosGraph graph(limits);
    EXPECT_TRUE(graph.Apply(content_).ok());
    return graph;
  }
  GraphHealth Examine() { return ExamineGraph(Graph(), expected_); }

  ros2::GraphDelta content_;
  uint8_t count_ = 0;
  GraphExpectation expected_ = {.sensor = "pc1", .domain = 7};
};

constexpr char kNobody[] =
    "sensor pc1 sees no ROS node on domain 7; are dds.domain and dds.interface right?";

TEST_F(GraphHealthTest, NobodyButRipsIsNobody) {
  EXPECT_THAT(Examine().problems, ElementsAre(kNobody));
  EXPECT_TRUE(Examine().empty);
  EXPECT_THAT(ExamineGraph(ros2::RosGraph(), expected_).problems, ElementsAre(kNobody));
  // An actuator that the sensor has not been told of yet, and one that names itself.
  content_.upsert_participants.push_back({.guid = ParticipantGuid(2)});
  Add(2, ros2::EndpointKind::kClient, "/safety/change_mode", "");
  Node(3, "/rips");
  expected_.own_participants = {ParticipantGuid(2)};
  EXPECT_THAT(Examine().problems, ElementsAre(kNobody));
}

TEST_F(GraphHealthTest, AfterTheAddressHasChangedTheConfigurationIsNotToBlame) {
  expected_.moved = true;
  EXPECT_THAT(Examine().problems,
              ElementsAre("sensor pc1 sees no ROS node on domain 7 since its host's addresses "
                          "changed; start the ROS nodes again"));
}

TEST_F(GraphHealthTest, WhatIsNoRosIsNobody) {
  content_.upsert_participants.push_back({.guid = ParticipantGuid(2)});
  Add(2, ros2::EndpointKind::kPublisher, "Square", "").ros = false;
  Add(2, ros2::EndpointKind::kPublisher, "/new", "").pending = true;
  EXPECT_THAT(Examine().problems, ElementsAre(kNobody));
}

TEST_F(GraphHealthTest, ANodeOrAnEndpointOfRosIsSomebody) {
  content_.upsert_participants.push_back({.guid = ParticipantGuid(2)});
  Add(2, ros2::EndpointKind::kPublisher, "/chatter", "");
  EXPECT_THAT(Examine().problems, IsEmpty()) << "without a node, as of a microcontroller";
  EXPECT_FALSE(Examine().empty);
  content_.upsert_endpoints.pop_back();
  Node(3, "/talker");
  EXPECT_THAT(Examine().problems, IsEmpty());
}

TEST_F(GraphHealthTest, PartsThatTheActuatorSteersMustBeThere) {
  Node(2, "/talker");
  expected_.parts = {"/base", "/camera", "/ns/lidar", "/safety"};
  const GraphHealth none = Examine();
  EXPECT_FALSE(none.empty);
  EXPECT_THAT(none.problems, ElementsAre("sensor pc1 does not see /base, /camera, /ns/lidar and 1 "
                                         "more on domain 7, whose modes the actuator sets"));

  Node(3, "/camera");
  Node(4, "/mode_manager");
  Add(4, ros2::EndpointKind::kService, "/safety/change_mode", "/mode_manager");
  Add(4, ros2::EndpointKind::kService, "/ns/lidar/get_mode", "/mode_manager");
  // Those who call a part, or are named almost like it, are not the part.
  Add(2, ros2::EndpointKind::kClient, "/base/change_mode", "/talker");
  Add(2, ros2::EndpointKind::kPublisher, "/base/odom", "/talker");
  Add(2, ros2::EndpointKind::kService, "/base2/change_mode", "/talker");
  Add(2, ros2::EndpointKind::kService, "/x/base/change_mode", "/talker");
  EXPECT_THAT(Examine().problems,
              ElementsAre("sensor pc1 does not see /base on domain 7, whose modes the actuator "
                          "sets"));
  Node(5, "/base");
  EXPECT_THAT(Examine().problems, IsEmpty());
}

TEST_F(GraphHealthTest, APartOfRipsItselfIsNotThePart) {
  Node(2, "/talker");
  expected_.parts = {"/safety"};
  expected_.own_participants = {ParticipantGuid(3)};
  Node(3, "/safety");
  Add(3, ros2::EndpointKind::kService, "/safety/change_mode", "/safety");
  EXPECT_EQ(Examine().problems.size(), 1u);
}

TEST_F(GraphHealthTest, ATruncatedGraphIsAProblemOfItsOwn) {
  Node(2, "/talker");
  for (int i = 0; i < 5; ++i) Add(2, ros2::EndpointKind::kPublisher, "/t", "/talker");
  EXPECT_EQ(Examine().truncated, "");
  const ros2::RosGraph graph = Graph({.endpoints = 4});
  const GraphHealth health = ExamineGraph(graph, expected_);
  EXPECT_THAT(health.problems, IsEmpty());
  EXPECT_THAT(health.truncated, HasSubstr("the graph of sensor pc1 hit a limit"));
  EXPECT_EQ(LargestParticipant(graph),
            absl::StrCat("participant ", ToString(ParticipantGuid(2)),
                         " (node /talker) has 1 of 2 nodes and 3 of 4 endpoints, 2 more left out; "
                         "2 participants"));
  EXPECT_EQ(LargestParticipant(ros2::RosGraph()), "");
}

TEST_F(GraphHealthTest, TheObserverIsNotWhoFillsTheGraph) {
  Node(2, "/flood");
  for (int i = 0; i < 3; ++i) {
    Add(2, ros2::EndpointKind::kPublisher, absl::StrCat("/t", i), "/flood");
    Add(1, ros2::EndpointKind::kSubscriber, absl::StrCat("/t", i), "/rips");
  }
  EXPECT_THAT(LargestParticipant(Graph()), HasSubstr("(node /flood) has 1 of 2 nodes and 3 of 7"));
}

TEST_F(GraphHealthTest, TheLargestIsNamedWithItsHostAndProcessAndWhatItLacks) {
  content_.upsert_participants.push_back(
      {.guid = ParticipantGuid(2), .host = "ba\x1bse", .pid = 4'711});
  for (const char* node : {"/a", "/b", "/c", "/d", "/e"}) {
    content_.upsert_nodes.push_back({.full_name = node, .participant = ParticipantGuid(2)});
  }
  Node(3, "/larger");
  for (int i = 0; i < 9; ++i) {
    Add(3, ros2::EndpointKind::kPublisher, absl::StrCat("/t", i), "/larger");
  }
  // Little of it is shown, and most of it is left out.
  content_.truncation = ros2::Truncation{.left_out = 64, .crowds = {{ParticipantGuid(2), 5, 63}}};
  EXPECT_EQ(LargestParticipant(Graph()),
            absl::StrCat("participant ", ToString(ParticipantGuid(2)),
                         " (host ba\\x1bse, pid 4711, nodes /a, /b, /c and 2 more) has 5 of 7 "
                         "nodes and 5 of 10 endpoints, 63 more left out; 3 participants"));
  EXPECT_EQ(DescribeParticipant(Graph(), ParticipantGuid(9)),
            absl::StrCat("participant ", ToString(ParticipantGuid(9))));
}

// ------------------------------------------------------------------------------------ the alarm

class BlindAlarmTest : public testing::Test {
 protected:
  std::vector<std::string> At(int64_t seconds, const std::vector<std::string>& reasons) {
    alarm_.Set(reasons, seconds * kNanosPerSecond);
    return alarm_.Due(seconds * kNanosPerSecond);
  }
  BlindAlarm alarm_;
};

TEST_F(BlindAlarmTest, TellsOnceWhatHasStoodForAMinute) {
  EXPECT_THAT(At(100, {"a"}), IsEmpty());
  EXPECT_THAT(At(159, {"a", "b"}), IsEmpty());
  EXPECT_THAT(At(160, {"a", "b"}), ElementsAre("a"));
  EXPECT_THAT(At(219, {"a", "b"}), ElementsAre("b"));
  for (int64_t second = 220; second < 3'000; second += 7) {
    EXPECT_THAT(At(second, {"a", "b"}), IsEmpty());
  }
  EXPECT_FALSE(alarm_.Over());
}

TEST_F(BlindAlarmTest, WhatIsOverInTimeIsNeverTold) {
  for (int64_t second = 0; second < 1'000; second += 60) {
    EXPECT_THAT(At(second, {"a"}), IsEmpty());
    EXPECT_THAT(At(second + 59, {"a"}), IsEmpty());
    EXPECT_THAT(At(second + 59, {}), IsEmpty());
    EXPECT_FALSE(alarm_.Over());
  }
}

TEST_F(BlindAlarmTest, SaysOnceWhenAllIsSeenAgain) {
  At(0, {"a", "b"});
  EXPECT_THAT(At(60, {"a", "b"}), ElementsAre("a", "b"));
  At(61, {"b"});
  EXPECT_FALSE(alarm_.Over());
  At(62, {});
  EXPECT_TRUE(alarm_.Over());
  EXPECT_FALSE(alarm_.Over());
}

TEST_F(BlindAlarmTest, WhatComesAndGoesIsNoFlood) {
  int told = 0;
  for (int64_t second = 0; second < 3'600; second += 100) {
    told += static_cast<int>(At(second, {"a"}).size() + At(second + 70, {"a"}).size());
    At(second + 80, {});
    alarm_.Over();
  }
  EXPECT_EQ(told, 1);
  At(3'600 + 700, {});
  EXPECT_THAT(At(3'600 + 710, {"a"}), IsEmpty());
  EXPECT_THAT(At(3'600 + 770, {"a"}), ElementsAre("a")) << "it had been gone for ten minutes";
}

TEST_F(BlindAlarmTest, ThatDdsBeginsAgainIsToldAtOnceAndOnce) {
  const std::string moved = absl::StrCat("sensor base: ", model::kDdsBeginsAgain, "eth0 had a");
  EXPECT_THAT(At(100, {"a", moved}), ElementsAre(moved));
  EXPECT_THAT(At(101, {"a", moved}), IsEmpty());
  EXPECT_THAT(At(105, {}), IsEmpty());
  EXPECT_TRUE(alarm_.Over());
  for (int64_t second = 110; second < 600; second += 10) {
    EXPECT_THAT(At(second, {moved}), IsEmpty());
    EXPECT_THAT(At(second + 5, {}), IsEmpty());
  }
  At(1'199, {});
  EXPECT_THAT(At(1'200, {moved}), ElementsAre(moved)) << "it had been gone for ten minutes";
}

TEST_F(BlindAlarmTest, ThatDdsBeganAgainIsToldThoughItIsOverBeforeAnybodyLooks) {
  const std::string moved = absl::StrCat(model::kDdsBeginsAgain, "eth0 had a");
  alarm_.Set({moved}, 0);
  alarm_.Set({}, 1);
  alarm_.Set({}, 2);
  EXPECT_THAT(alarm_.Due(3), ElementsAre(moved));
  EXPECT_TRUE(alarm_.Over());
}

TEST_F(BlindAlarmTest, RemembersABoundedNumber) {
  std::vector<std::string> many;
  for (size_t i = 0; i < 2 * BlindAlarm::kReasonsMax; ++i) many.push_back(absl::StrCat(i));
  At(0, many);
  EXPECT_EQ(At(60, many).size(), BlindAlarm::kReasonsMax);
}

}  // namespace
}  // namespace rips::pipeline
