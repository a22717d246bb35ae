#include "services/dds/discovery.h"

#include <unistd.h>

#include <map>
#include <optional>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "services/base/status_matchers.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/dds/service_client.h"
#include "services/runtime/mutex.h"
#include "tests/support/ros2/test_world.h"

namespace rips::dds {
namespace {

using ::testing::ElementsAre;

// The newest word on everything.
class Seen {
 public:
  DiscoveryCallbacks Callbacks() {
    return {.on_participant =
                [this](const ParticipantSeen& seen) {
                  MutexLock lock(&mu_);
                  participants_[seen.guid] = seen;
                },
            .on_endpoint =
                [this](const EndpointSeen& seen) {
                  MutexLock lock(&mu_);
                  endpoints_[seen.guid] = seen;
                }};
  }
  std::optional<ParticipantSeen> FindParticipant(const ros2::Guid& guid) {
    MutexLock lock(&mu_);
    const auto at = participants_.find(guid);
    return at == participants_.end() ? std::nullopt : std::optional(at->second);
  }
  std::optional<EndpointSeen> FindEndpoint(const ros2::Guid& guid) {
    MutexLock lock(&mu_);
    const auto at = endpoints_.find(guid);
    return at == endpoints_.end() ? std::nullopt : std::optional(at->second);
  }
  std::vector<EndpointSeen> Endpoints() {
    MutexLock lock(&mu_);
    std::vector<EndpointSeen> all;
    for (const auto& [guid, seen] : endpoints_) all.push_back(seen);
    return all;
  }
  bool Alive(const ros2::Guid& guid) {
    const auto participant = FindParticipant(guid);
    const auto endpoint = FindEndpoint(guid);
    return (participant && participant->alive) || (endpoint && endpoint->alive);
  }

 private:
  Mutex mu_;
  std::map<ros2::Guid, ParticipantSeen> participants_;
  std::map<ros2::Guid, EndpointSeen> endpoints_;
};

class DiscoveryTest : public TestWorld {
 protected:
  void Watch() {
    auto discovery = Discovery::Create(near(), seen_.Callbacks());
    ASSERT_THAT(discovery, IsOk());
    discovery_ = *std::move(discovery);
  }
  std::unique_ptr<RawWriter> FarWriter(ros2::Qos qos) {
    return *RawWriter::Create(far(), {.topic = "rt/cmd_vel",
                                      .type = "geometry_msgs::msg::dds_::Twist_",
                                      .qos = std::move(qos),
                                      .user_data = "typehash=x;"});
  }

  Seen seen_;
  std::unique_ptr<Discovery> discovery_;
};

TEST_F(DiscoveryTest, AParticipantComesAndGoes) {
  Watch();
  const ros2::Guid guid = far().guid();
  ASSERT_TRUE(Eventually([&] { return seen_.Alive(guid); }));
  const ParticipantSeen seen = *seen_.FindParticipant(guid);
  EXPECT_EQ(seen.enclave, "/");
  EXPECT_EQ(seen.pid, static_cast<uint32_t>(getpid()));
  EXPECT_FALSE(seen.host.empty());
  EXPECT_THAT(seen.process, ::testing::HasSubstr("dds_test"));
  EXPECT_EQ(seen.vendor, "0110");
  EXPECT_FALSE(seen.addresses.empty());
  EXPECT_NE(seen.instance, 0u);
  DropFar();
  ASSERT_TRUE(Eventually([&] { return !seen_.Alive(guid); }));
}

TEST_F(DiscoveryTest, EndpointsComeAndGoWithTheirQos) {
  Watch();
  auto writer = FarWriter(
      {.reliable = true, .transient_local = true, .depth = 7, .partitions = {"evil", "b"}});
  auto reader =
      *RawReader::Create(far(), {.topic = "rt/scan", .type = "sensor_msgs::msg::dds_::LaserScan_"},
                         [](const RawSample&) {});
  ASSERT_TRUE(
      Eventually([&] { return seen_.Alive(writer->guid()) && seen_.Alive(reader->guid()); }));
  const EndpointSeen w = *seen_.FindEndpoint(writer->guid());
  EXPECT_TRUE(w.writer);
  EXPECT_EQ(w.participant, far().guid());
  EXPECT_EQ(w.topic, "rt/cmd_vel");
  EXPECT_EQ(w.type, "geometry_msgs::msg::dds_::Twist_");
  EXPECT_TRUE(w.qos.reliable && w.qos.transient_local && !w.qos.keep_all);
  EXPECT_THAT(w.qos.partitions, ElementsAre("evil", "b"));
  EXPECT_EQ(w.user_data, "typehash=x;");
  const EndpointSeen r = *seen_.FindEndpoint(reader->guid());
  EXPECT_FALSE(r.writer);
  EXPECT_EQ(r.topic, "rt/scan");
  EXPECT_FALSE(r.qos.reliable || r.qos.transient_local);
  const std::pair<ros2::Guid, ros2::Guid> gone = {writer->guid(), reader->guid()};
  writer.reset();
  reader.reset();
  ASSERT_TRUE(Eventually([&] { return !seen_.Alive(gone.first) && !seen_.Alive(gone.second); }));
  EXPECT_EQ(seen_.FindEndpoint(gone.first)->participant, far().guid());
}

TEST_F(DiscoveryTest, WhatWasThereBeforeIsReported) {
  const auto writer = FarWriter({.reliable = true, .depth = 1, .partitions = {}});
  const auto own = *RawWriter::Create(near(), {.topic = "rt/own", .type = "T"});
  const auto reader = *RawReader::Create(
      near(), {.topic = "rt/cmd_vel", .type = "geometry_msgs::msg::dds_::Twist_"},
      [](const RawSample&) {});
  ASSERT_TRUE(Eventually([&] { return !reader->MatchedWriters().empty(); }));
  Watch();
  EXPECT_TRUE(Eventually([&] {
    return seen_.Alive(writer->guid()) && seen_.Alive(own->guid()) && seen_.Alive(near().guid());
  }));
  for (const EndpointSeen& seen : seen_.Endpoints()) {
    EXPECT_FALSE(absl::StartsWith(seen.type, "org::eclipse")) << seen.type;
  }
}

TEST_F(DiscoveryTest, ASampleNamesItsWritersInstance) {
  Watch();
  Mutex mu;
  InstanceHandle publication = 0;
  const auto reader = *RawReader::Create(
      near(), {.topic = "rt/cmd_vel", .type = "geometry_msgs::msg::dds_::Twist_"},
      [&](const RawSample& sample) {
        MutexLock lock(&mu);
        publication = sample.publication;
      });
  const auto writer = FarWriter({.reliable = true, .depth = 1, .partitions = {}});
  ASSERT_TRUE(Eventually(
      [&] { return writer->MatchedReaders() == 1 && !reader->MatchedWriters().empty(); }));
  ASSERT_THAT(writer->Write(std::string("\0\1\0\0\0\0\0\0", 8)), IsOk());
  ASSERT_TRUE(Eventually([&] {
    MutexLock lock(&mu);
    return publication != 0;
  }));
  ASSERT_TRUE(Eventually([&] { return seen_.Alive(writer->guid()); }));
  MutexLock lock(&mu);
  EXPECT_EQ(seen_.FindEndpoint(writer->guid())->instance, publication);
}

TEST_F(DiscoveryTest, AServiceClientLooksLikeOneOfRos) {
  Watch();
  const auto client = *ServiceClient::Create(
      far(), {.service = "/safety/get_mode", .type = "system_modes_msgs/srv/GetMode"});
  ASSERT_TRUE(Eventually([&] {
    return seen_.Alive(client->request_writer()) && seen_.Alive(client->reply_reader());
  }));
  const EndpointSeen request = *seen_.FindEndpoint(client->request_writer());
  const EndpointSeen reply = *seen_.FindEndpoint(client->reply_reader());
  EXPECT_EQ(request.topic, "rq/safety/get_modeRequest");
  EXPECT_EQ(request.type, "system_modes_msgs::srv::dds_::GetMode_Request_");
  EXPECT_EQ(reply.topic, "rr/safety/get_modeReply");
  EXPECT_EQ(reply.type, "system_modes_msgs::srv::dds_::GetMode_Response_");
  EXPECT_THAT(request.user_data,
              ::testing::MatchesRegex("clientid=[ 0-9a-f]?[0-9a-f](\\.[0-9a-f]{1,2}){15};"));
  EXPECT_EQ(request.user_data, reply.user_data);
  EXPECT_TRUE(request.qos.reliable && reply.qos.reliable);
  EXPECT_TRUE(request.qos.partitions.empty() && reply.qos.partitions.empty());
}

}  // namespace
}  // namespace rips::dds
