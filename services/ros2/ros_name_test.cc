#include "services/ros2/ros_name.h"

#include "gtest/gtest.h"
#include "services/base/status_matchers.h"

namespace rips::ros2 {
namespace {

TEST(DemangleTopicTest, RosForms) {
  using K = DdsTopicKind;
  const std::pair<const char*, DemangledTopic> cases[] = {
      {"rt/chatter", {K::kTopic, "/chatter"}},
      {"rt/a/b_2/_hidden", {K::kTopic, "/a/b_2/_hidden"}},
      {"rq/s/change_modeRequest", {K::kServiceRequest, "/s/change_mode"}},
      {"rr/s/change_modeReply", {K::kServiceReply, "/s/change_mode"}},
      {"rq/x/_action/send_goalRequest", {K::kServiceRequest, "/x/_action/send_goal"}},
      // Not ROS names, though they look like some.
      {"ros_discovery_info", {K::kOther, "ros_discovery_info"}},
      {"rt", {K::kOther, "rt"}},
      {"rt/", {K::kOther, "rt/"}},
      {"rtchatter", {K::kOther, "rtchatter"}},
      {"rt/a//b", {K::kOther, "rt/a//b"}},
      {"rt/a/", {K::kOther, "rt/a/"}},
      {"rt/1a", {K::kOther, "rt/1a"}},
      {"rt/a b", {K::kOther, "rt/a b"}},
      {"rq/s", {K::kOther, "rq/s"}},
      {"rq/Request", {K::kOther, "rq/Request"}},
      {"rr/sRequest", {K::kOther, "rr/sRequest"}},
      {"rt/caf\xc3\xa9", {K::kOther, "rt/caf\\xc3\\xa9"}},
      {"", {K::kOther, ""}},
  };
  for (const auto& [dds, expected] : cases) {
    EXPECT_EQ(DemangleTopic(dds).kind, expected.kind) << dds;
    EXPECT_EQ(DemangleTopic(dds).name, expected.name) << dds;
  }
}

TEST(DemangleTopicTest, InverseOfMangle) {
  EXPECT_EQ(DemangleTopic(MangleTopic("/a/b")), (DemangledTopic{DdsTopicKind::kTopic, "/a/b"}));
  EXPECT_EQ(DemangleTopic(MangleServiceRequest("/a/s")),
            (DemangledTopic{DdsTopicKind::kServiceRequest, "/a/s"}));
  EXPECT_EQ(DemangleTopic(MangleServiceReply("/a/s")),
            (DemangledTopic{DdsTopicKind::kServiceReply, "/a/s"}));
}

TEST(DemangleTypeTest, Forms) {
  const std::pair<const char*, const char*> cases[] = {
      {"std_msgs::msg::dds_::String_", "std_msgs/msg/String"},
      {"system_modes_msgs::srv::dds_::ChangeMode_Request_", "system_modes_msgs/srv/ChangeMode"},
      {"system_modes_msgs::srv::dds_::ChangeMode_Response_", "system_modes_msgs/srv/ChangeMode"},
      {"p::action::dds_::F_SendGoal_Request_", "p/action/F_SendGoal"},
      {"p::action::dds_::F_FeedbackMessage_", "p/action/F_FeedbackMessage"},
      // A message may be called so.
      {"p::msg::dds_::Foo_Request_", "p/msg/Foo_Request"},
      {"std_msgs::msg::dds_::String", "std_msgs::msg::dds_::String"},
      {"dds_::String_", "dds_::String_"},
      {"HelloWorldData::Msg", "HelloWorldData::Msg"},
      {"a b::msg::dds_::T_", "a b::msg::dds_::T_"},
      {"x\n", "x\\x0a"},
  };
  for (const auto& [dds, expected] : cases) EXPECT_EQ(DemangleType(dds), expected);
  EXPECT_EQ(MangleType("std_msgs/msg/String"), "std_msgs::msg::dds_::String_");
  EXPECT_EQ(MangleServiceRequestType("std_srvs/srv/SetBool"),
            "std_srvs::srv::dds_::SetBool_Request_");
  EXPECT_EQ(MangleServiceReplyType("std_srvs/srv/SetBool"),
            "std_srvs::srv::dds_::SetBool_Response_");
}

TEST(KindOfTest, Table) {
  using K = DdsTopicKind;
  EXPECT_EQ(KindOf(K::kTopic, true), EndpointKind::kPublisher);
  EXPECT_EQ(KindOf(K::kTopic, false), EndpointKind::kSubscriber);
  EXPECT_EQ(KindOf(K::kOther, true), EndpointKind::kPublisher);
  EXPECT_EQ(KindOf(K::kOther, false), EndpointKind::kSubscriber);
  EXPECT_EQ(KindOf(K::kServiceRequest, true), EndpointKind::kClient);
  EXPECT_EQ(KindOf(K::kServiceRequest, false), EndpointKind::kService);
  EXPECT_EQ(KindOf(K::kServiceReply, true), EndpointKind::kService);
  EXPECT_EQ(KindOf(K::kServiceReply, false), EndpointKind::kClient);
}

TEST(ValidateNameTest, LengthLimit) {
  EXPECT_THAT(ValidateTopicName("/" + std::string(kRosNameBytesMax - 1, 'a')), IsOk());
  EXPECT_THAT(
      ValidateTopicName("/" + std::string(kRosNameBytesMax, 'a')),
      StatusIs(absl::StatusCode::kInvalidArgument, "ROS name of 256 bytes exceeds limit 255"));
  EXPECT_FALSE(ValidateNodeName("").ok());
  EXPECT_FALSE(ValidateNodeName("/").ok());
  EXPECT_FALSE(ValidateNodeName("n").ok());
  EXPECT_TRUE(ValidateNodeName("/__mode_manager").ok());
}

TEST(NameTest, HiddenAndJoined) {
  EXPECT_EQ(JoinNodeName("/", "n"), "/n");
  EXPECT_EQ(JoinNodeName("/ns/m", "n"), "/ns/m/n");
}

TEST(PrintableTest, EscapesAndCuts) {
  EXPECT_EQ(Printable("a\\b\x01"), "a\\x5cb\\x01");
  const std::string cut = Printable(std::string(10'000, '\xff'));
  EXPECT_LE(cut.size(), kPrintableBytesMax);
  EXPECT_EQ(cut.substr(cut.size() - 7), "\\xff...");
  // What was printed once is not cut again.
  EXPECT_EQ(Printable(std::string(500, 'a')), std::string(500, 'a'));
}

}  // namespace
}  // namespace rips::ros2
