// A small ROS 2 robot on real DDS for tests, in this process but behind RTPS packets on loopback.
// Test code only.
#ifndef RIPS_SENSOR_AGENT_FAKE_ROBOT_H_
#define RIPS_SENSOR_AGENT_FAKE_ROBOT_H_

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gtest/gtest.h"
#include "services/dds/participant.h"
#include "services/dds/raw_reader.h"
#include "services/dds/raw_writer.h"
#include "services/ros2/cdr.h"
#include "services/ros2/discovery_info.h"
#include "services/ros2/ros_name.h"
#include "tests/support/ros2/test_world.h"

namespace rips::sensor {

// One process of the robot: a participant with at most one node.
class FakeProcess {
 public:
  explicit FakeProcess(std::unique_ptr<dds::Participant> participant)
      : participant_(std::move(participant)) {
    auto info = dds::RawWriter::Create(
        *participant_, {.topic = ros2::kDiscoveryTopic,
                        .type = ros2::kDiscoveryType,
                        .qos = {.reliable = true, .transient_local = true, .depth = 1}});
    EXPECT_TRUE(info.ok()) << info.status();
    info_ = *std::move(info);
  }

  const dds::Participant& participant() const { return *participant_; }

  // A publisher of std_msgs/msg/String.
  dds::RawWriter& AddWriter(const std::string& topic,
                            ros2::Qos qos = {.reliable = true, .depth = 7}) {
    auto writer = dds::RawWriter::Create(
        *participant_, {.topic = topic, .type = "std_msgs::msg::dds_::String_", .qos = qos});
    EXPECT_TRUE(writer.ok()) << writer.status();
    return *(writers_[topic] = *std::move(writer));
  }
  // A subscriber, which throws away what it reads.
  void AddReader(const std::string& topic) {
    auto reader = dds::RawReader::Create(*participant_,
                                         {.topic = topic, .type = "std_msgs::msg::dds_::String_"},
                                         [](const dds::RawSample&) {});
    EXPECT_TRUE(reader.ok()) << reader.status();
    readers_.push_back(*std::move(reader));
  }
  void RemoveWriter(const std::string& topic) { writers_.erase(topic); }

  // Tells that all writers and readers belong to `node`.
  void Announce(const std::string& node, ros2::GidBytes gid_bytes = ros2::GidBytes::k24,
                std::vector<ros2::Guid> more_writers = {}) {
    ros2::NodeEntities entities{.node_namespace = "/", .node_name = node};
    for (const auto& [topic, writer] : writers_) entities.writers.push_back(writer->guid());
    for (const auto& reader : readers_) entities.readers.push_back(reader->guid());
    for (const ros2::Guid& guid : more_writers) entities.writers.push_back(guid);
    EXPECT_TRUE(
        info_
            ->Write(ros2::EncodeParticipantEntities(
                {.participant = participant_->guid(), .nodes = {entities}, .gid_bytes = gid_bytes}))
            .ok());
  }
  void AnnounceBytes(const std::string& payload) { EXPECT_TRUE(info_->Write(payload).ok()); }

  void Publish(const std::string& topic, const std::string& text = "hello") {
    ros2::CdrWriter cdr;
    cdr.String(text);
    EXPECT_TRUE(writers_.at(topic)->Write(std::move(cdr).Finish()).ok());
  }
  size_t MatchedReaders(const std::string& topic) const {
    return writers_.at(topic)->MatchedReaders();
  }

 private:
  std::unique_ptr<dds::Participant> participant_;
  std::unique_ptr<dds::RawWriter> info_;
  std::map<std::string, std::unique_ptr<dds::RawWriter>> writers_;
  std::vector<std::unique_ptr<dds::RawReader>> readers_;
};

// Processes that share one domain of the middleware, whose packets use the ports of
// dds::RandomDomain().
class FakeRobot {
 public:
  // `domain_id` tells robots of one process apart; they share the bus all the same. Processes of
  // one robot all use DDS Security, or none does.
  explicit FakeRobot(uint32_t domain_id = 1) {
    {
      const dds::ScopedCycloneUri uri(
          Xml(absl::StrCat("<ExternalDomainId>", dds::RandomDomain(), "</ExternalDomainId>")));
      auto domain = dds::Domain::Create({.id = domain_id});
      EXPECT_TRUE(domain.ok()) << domain.status();
      domain_ = *std::move(domain);
    }
    // The sensor under test, here or in a child process, sees us and no other test.
    setenv("CYCLONEDDS_URI", Xml("").c_str(), /*overwrite=*/1);
  }
  ~FakeRobot() { unsetenv("CYCLONEDDS_URI"); }

  const std::shared_ptr<const dds::Domain>& domain() const { return domain_; }

  std::unique_ptr<FakeProcess> AddProcess(std::optional<dds::Enclave> enclave = std::nullopt) {
    return std::make_unique<FakeProcess>(AddParticipant(std::move(enclave)));
  }
  // A process that is no ROS process.
  std::unique_ptr<dds::Participant> AddParticipant(
      std::optional<dds::Enclave> enclave = std::nullopt) {
    auto participant = dds::Participant::Create(domain_, {.security = std::move(enclave)});
    EXPECT_TRUE(participant.ok()) << participant.status();
    return *std::move(participant);
  }

 private:
  static std::string Xml(const std::string& domain) {
    return absl::StrCat(
        "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"lo\" "
        "multicast=\"true\"/></Interfaces></General><Discovery>",
        domain, "<Tag>", dds::Tag(),
        "</Tag><ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>");
  }

  std::shared_ptr<const dds::Domain> domain_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_FAKE_ROBOT_H_
