#include "services/dds/node_announcer.h"

#include <string>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/dds/service_client.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/ros_name.h"
#include "tests/support/ros2/ros_view.h"
#include "tests/support/ros2/test_keystore.h"
#include "tests/support/ros2/test_world.h"

namespace rips::dds {
namespace {

using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

constexpr char kType[] = "std_msgs::msg::dds_::String_";
constexpr int64_t kSecond = 1'000'000'000;
const RawCallback kIgnore = [](const RawSample&) {};

class NodeAnnouncerTest : public TestWorld {
 protected:
  std::unique_ptr<NodeAnnouncer> Announcer(NodeAnnouncerOptions options = {}) {
    auto announcer = NodeAnnouncer::Create(near(), std::move(options), now_ns_);
    EXPECT_THAT(announcer, IsOk());
    return *std::move(announcer);
  }
  std::unique_ptr<RawReader> Reader(const std::string& topic) {
    auto reader = RawReader::Create(near(), {.topic = topic, .type = kType}, kIgnore);
    EXPECT_THAT(reader, IsOk());
    return *std::move(reader);
  }
  static std::string Claim(ros2::GidBytes form, const std::string& node = "",
                           const ros2::Guid& participant = {}) {
    ros2::ParticipantEntities info{.participant = participant, .gid_bytes = form};
    if (!node.empty()) info.nodes.push_back({.node_namespace = "/", .node_name = node});
    return ros2::EncodeParticipantEntities(info);
  }
  // Another process of the robot, which claims in that form.
  std::unique_ptr<RawWriter> Speak(Participant& in, ros2::GidBytes form) {
    auto writer =
        RawWriter::Create(in, {.topic = ros2::kDiscoveryTopic,
                               .type = ros2::kDiscoveryType,
                               .qos = {.reliable = true, .transient_local = true, .depth = 1}});
    EXPECT_THAT(writer, IsOk());
    EXPECT_THAT((*writer)->Write(Claim(form, "", in.guid())), IsOk());
    return *std::move(writer);
  }

  int64_t now_ns_ = 100 * kSecond;
};

TEST_F(NodeAnnouncerTest, OwnsEveryReaderAndWriterAsTheyComeAndGo) {
  RosView ros(far(), ros2::GidBytes::k24);
  auto announcer = Announcer();
  EXPECT_TRUE(Eventually([&] { return ros.HasClaimOf(near().guid()); })) << "before any endpoint";

  auto first = Reader("rt/camera");
  const auto client = ServiceClient::Create(
      near(), {.service = "/safety/change_mode", .type = "system_modes_msgs/srv/ChangeMode"});
  ASSERT_THAT(client, IsOk());
  EXPECT_TRUE(Eventually([&] { return ros.NodeOf(first->guid()) == "_NODE_NAME_UNKNOWN_"; }))
      << "as it is without a claim";
  EXPECT_EQ(announcer->NextDue(), now_ns_ + NodeAnnouncer::kClaimIntervalNs);
  EXPECT_THAT(announcer->Poll(now_ns_), IsOk());
  EXPECT_EQ(announcer->published(), 1u) << "not so soon after the last";
  now_ns_ = announcer->NextDue();
  EXPECT_THAT(announcer->Poll(now_ns_), IsOk());
  EXPECT_TRUE(Eventually([&] {
    return ros.NodesOf(near().guid()) == std::vector<std::string>{"/rips", "/rips", "/rips"};
  }));

  auto second = Reader("rt/scan");
  first.reset();
  now_ns_ = announcer->NextDue();
  EXPECT_THAT(announcer->Poll(now_ns_), IsOk());
  EXPECT_TRUE(Eventually([&] { return ros.NodeOf(second->guid()) == "/rips"; }));
  EXPECT_EQ(announcer->published(), 3u);
  now_ns_ += 60 * kSecond;
  EXPECT_THAT(announcer->Poll(now_ns_), IsOk());
  EXPECT_EQ(announcer->published(), 3u) << "nothing has changed";
  EXPECT_GT(announcer->NextDue(), now_ns_ + 1'000 * kSecond);
}

TEST_F(NodeAnnouncerTest, WhoComesLaterIsToldTheNewest) {
  auto announcer = Announcer();
  const auto reader = Reader("rt/camera");
  EXPECT_THAT(announcer->Poll(now_ns_ += kSecond), IsOk());
  RosView ros(far(), ros2::GidBytes::k24);
  EXPECT_TRUE(Eventually([&] { return ros.NodeOf(reader->guid()) == "/rips"; }));
  EXPECT_EQ(ros.claims(), 1u) << "the latched one";
}

TEST_F(NodeAnnouncerTest, WhatBelongsToNoNodeIsNotListed) {
  RosView ros(far(), ros2::GidBytes::k24);
  const auto raw = Reader("Square");
  const auto claims = RawReader::Create(
      near(), {.topic = ros2::kDiscoveryTopic, .type = ros2::kDiscoveryType}, kIgnore);
  ASSERT_THAT(claims, IsOk());
  EXPECT_THAT(near().own_endpoints()->Now().readers, IsEmpty());
  auto announcer = Announcer();
  EXPECT_THAT(near().own_endpoints()->Now().writers, IsEmpty());
}

TEST_F(NodeAnnouncerTest, ManyReadersAreOneClaimInAWhile) {
  auto announcer = Announcer();
  std::vector<std::unique_ptr<RawReader>> readers;
  for (int i = 0; i < 45; ++i) {
    readers.push_back(Reader(absl::StrCat("rt/t", i)));
    EXPECT_THAT(announcer->Poll(now_ns_ += 1'000'000), IsOk());
  }
  EXPECT_EQ(announcer->published(), 1u);
  EXPECT_THAT(announcer->Poll(now_ns_ = announcer->NextDue()), IsOk());
  EXPECT_THAT(near().own_endpoints()->Now().readers, SizeIs(45));
  readers.push_back(Reader("rt/last"));
  EXPECT_EQ(announcer->NextDue(),
            now_ns_ + NodeAnnouncer::kClaimIntervalNs + 45 * NodeAnnouncer::kEndpointIntervalNs)
      << "a long claim is sent more seldom";
}

TEST_F(NodeAnnouncerTest, SpeaksTheFormOfTheOthers) {
  RosView jazzy(far(), ros2::GidBytes::k16);
  auto announcer = Announcer({.listen = true});
  EXPECT_THAT(announcer->reading_status(), IsOk());
  const auto reader = Reader("rt/camera");
  EXPECT_THAT(announcer->Poll(now_ns_ += kSecond), IsOk());
  EXPECT_EQ(announcer->form(), ros2::GidBytes::k24) << "nobody has spoken";
  ASSERT_TRUE(Eventually([&] { return jazzy.HasClaimOf(near().guid()); }));
  EXPECT_NE(jazzy.NodeOf(reader->guid()), "/rips");

  auto writer = Speak(far(), ros2::GidBytes::k16);
  ASSERT_TRUE(Eventually([&] { return announcer->form() == ros2::GidBytes::k16; }));
  EXPECT_THAT(announcer->Poll(now_ns_ += kSecond), IsOk());
  EXPECT_TRUE(Eventually([&] { return jazzy.NodeOf(reader->guid()) == "/rips"; }));

  // It leaves, and another generation comes: whoever has left does not count.
  writer.reset();
  writer = Speak(far(), ros2::GidBytes::k24);
  EXPECT_TRUE(Eventually([&] {
    EXPECT_THAT(announcer->Poll(now_ns_ += kSecond), IsOk());
    return announcer->form() == ros2::GidBytes::k24;
  }));
}

TEST_F(NodeAnnouncerTest, AFormThatIsSetIsKept) {
  auto announcer = Announcer({.gid_bytes = ros2::GidBytes::k24, .listen = true});
  announcer->Heard(far().guid(), Claim(ros2::GidBytes::k16));
  EXPECT_EQ(announcer->form(), ros2::GidBytes::k24);
  EXPECT_GT(announcer->NextDue(), now_ns_ + 1'000 * kSecond);
}

TEST_F(NodeAnnouncerTest, AgentsDoNotKeepEachOtherInAForm) {
  auto announcer = Announcer();
  for (uint8_t i = 1; i <= 3; ++i) {  // the robot's other agents
    ros2::Guid agent = far().guid();
    agent.bytes[5] ^= i;
    announcer->Heard(agent, Claim(ros2::GidBytes::k24, "rips", agent));
  }
  announcer->Heard(far().guid(), Claim(ros2::GidBytes::k16, "talker", far().guid()));
  EXPECT_EQ(announcer->form(), ros2::GidBytes::k16);
  announcer->Heard(far().guid(), Claim(ros2::GidBytes::k24, "rips_viewer", far().guid()));
  EXPECT_EQ(announcer->form(), ros2::GidBytes::k24) << "no agent, though nearly";
}

TEST_F(NodeAnnouncerTest, NobodyMakesItFlap) {
  auto announcer = Announcer();
  for (int i = 0; i < 1'000; ++i) {  // ten seconds
    announcer->Heard(far().guid(), Claim(i % 2 == 0 ? ros2::GidBytes::k16 : ros2::GidBytes::k24));
    EXPECT_THAT(announcer->Poll(now_ns_ += 10'000'000), IsOk());
  }
  EXPECT_LE(announcer->published(), 12u);
}

TEST(NodeAnnouncerSettingsTest, AreThoseOfTheFile) {
  EXPECT_EQ(AnnouncerOptions({}).gid_bytes, std::nullopt);
  DdsSettings settings;
  settings.gid_bytes = 16;
  EXPECT_EQ(AnnouncerOptions(settings).gid_bytes, ros2::GidBytes::k16);
  settings.gid_bytes = 24;
  EXPECT_EQ(AnnouncerOptions(settings).gid_bytes, ros2::GidBytes::k24);
}

TEST(SecuredNodeAnnouncerTest, NeedsThePermissionAndSaysSo) {
  TestKeystore keystore;
  keystore.Mint("/rips/sensor", "sensor");
  keystore.Mint("/rips/actuator", "actuator");
  // As it was shipped before: a sensor that writes nothing.
  TestKeystore::Run(absl::StrCat("sed '/<publish>/d' ", RIPS_SOURCE_DIR,
                                 "/deploy/security/permissions.sensor.xml >", keystore.dir(),
                                 "/mute.xml"));
  keystore.Mint("/mute", absl::StrCat(keystore.dir(), "/mute.xml"));
  uint32_t sides = 0;
  const auto create = [&](const std::string& enclave) {
    const ScopedCycloneUri uri(absl::StrCat(
        "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" "
        "multicast=\"true\"/></Interfaces></General><Discovery><ExternalDomainId>",
        RandomDomain(), "</ExternalDomainId><Tag>", Tag(),
        "</Tag><ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>"));
    auto side = Participant::Create({.id = ++sides}, {.security = keystore.Load(enclave)});
    EXPECT_THAT(side, IsOk());
    return *std::move(side);
  };
  for (const char* enclave : {"/rips/sensor", "/rips/actuator"}) {
    const auto participant = create(enclave);
    const auto announcer = NodeAnnouncer::Create(*participant, {.listen = true}, 0);
    ASSERT_THAT(announcer, IsOk()) << enclave;
    EXPECT_THAT((*announcer)->reading_status(), IsOk()) << enclave;
  }
  const auto mute = create("/mute");
  const auto refused = NodeAnnouncer::Create(*mute, {}, 0);
  EXPECT_THAT(refused,
              StatusIs(absl::StatusCode::kPermissionDenied, HasSubstr("ros_discovery_info")));
}

}  // namespace
}  // namespace rips::dds
