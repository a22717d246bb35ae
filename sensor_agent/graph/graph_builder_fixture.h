// A GraphBuilder whose discovery and time the test plays. Test code only.
#ifndef RIPS_SENSOR_AGENT_GRAPH_GRAPH_BUILDER_FIXTURE_H_
#define RIPS_SENSOR_AGENT_GRAPH_GRAPH_BUILDER_FIXTURE_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/graph/graph_builder.h"
#include "services/base/status_matchers.h"

namespace rips::sensor {

using ros2::Endpoint;
using ros2::EndpointKind;
using ros2::Guid;
using ros2::RosGraph;
using ros2::Visibility;

inline constexpr int64_t kMs = 1'000'000;
inline constexpr char kStringType[] = "std_msgs::msg::dds_::String_";

inline Guid ParticipantGuid(uint8_t number) {
  Guid guid;
  guid.bytes = {0x01, 0x10, 0, 0, 0, 0, 0, 0, 0, 0, 0, number, 0, 0, 1, 0xc1};
  return guid;
}

inline Guid EndpointGuid(uint8_t participant, uint16_t number, bool writer = true) {
  Guid guid = ParticipantGuid(participant);
  guid.bytes[13] = static_cast<uint8_t>(number >> 8);
  guid.bytes[14] = static_cast<uint8_t>(number);
  guid.bytes[12] = 1;
  guid.bytes[15] = writer ? 0x03 : 0x04;
  return guid;
}

inline constexpr uint8_t kOwn = 200;

// Steps time, plays discovery, and keeps the graph as a server would.
class GraphBuilderTest : public testing::Test {
 protected:
  explicit GraphBuilderTest(GraphOptions options = {}) : options_(std::move(options)) {
    options_.own = ParticipantGuid(kOwn);
    Restart();
  }

  void Restart() {
    now_ns_ = 1'000'000 * kMs;
    builder_.emplace(options_, now_ns_);
    graph_.Clear();
    version_ = 0;
    changes_.clear();
  }

  void Participant(uint8_t number) {
    builder_->ParticipantSeen({.guid = ParticipantGuid(number), .host = "base"}, now_ns_);
  }
  void Seen(const Guid& guid, bool writer, const std::string& topic,
            const std::string& type = kStringType, ros2::Qos qos = {}) {
    builder_->EndpointSeen(
        {.guid = guid, .writer = writer, .topic = topic, .type = type, .qos = std::move(qos)},
        now_ns_);
  }
  void Writer(uint8_t participant, uint16_t number, const std::string& topic) {
    Seen(EndpointGuid(participant, number), true, topic);
  }
  absl::Status Claim(uint8_t participant, const std::string& node, std::vector<Guid> writers,
                     std::vector<Guid> readers = {}) {
    return builder_->NodesClaimed(EndpointGuid(participant, 999),
                                  {.participant = ParticipantGuid(participant),
                                   .nodes = {{.node_namespace = "/",
                                              .node_name = node,
                                              .readers = std::move(readers),
                                              .writers = std::move(writers)}}},
                                  now_ns_);
  }
  // A node with one publisher, as a well-behaved process shows it.
  void Talker(uint8_t participant, const std::string& node, const std::string& topic) {
    Participant(participant);
    Writer(participant, 1, topic);
    ASSERT_THAT(Claim(participant, node, {EndpointGuid(participant, 1)}), IsOk());
  }

  // Lets time pass in steps of 1 ms; changes are checked for contiguous versions and applied.
  void Pass(int64_t ms) {
    for (int64_t i = 0; i < ms; ++i) {
      now_ns_ += kMs;
      const int64_t due_ns = builder_->NextDue();
      std::vector<GraphChange> changes = builder_->Poll(now_ns_);
      if (!changes.empty()) {
        EXPECT_LE(due_ns, now_ns_) << "a change that NextDue did not promise";
      }
      Apply(std::move(changes));
    }
  }
  void Apply(std::vector<GraphChange> changes) {
    for (GraphChange& change : changes) {
      if (change.from_version == 0) {
        graph_.Clear();
        EXPECT_GT(change.to_version, version_);
      } else {
        EXPECT_EQ(change.from_version, version_);
        EXPECT_EQ(change.to_version, version_ + 1);
      }
      version_ = change.to_version;
      EXPECT_THAT(graph_.Apply(change.delta), IsOk());
      changes_.push_back(std::move(change));
    }
  }
  void Settle() {
    Pass(2'000);
    ASSERT_TRUE(builder_->settled());
    ASSERT_THAT(changes_, testing::Not(testing::IsEmpty()));
    changes_.clear();
  }
  std::vector<std::string> Publishers(const std::string& topic) {
    const ros2::Topic* found = graph_.FindTopic(topic);
    return found == nullptr ? std::vector<std::string>{} : found->publishers;
  }
  std::vector<std::string> Subscribers(const std::string& topic) {
    const ros2::Topic* found = graph_.FindTopic(topic);
    return found == nullptr ? std::vector<std::string>{} : found->subscribers;
  }
  std::vector<std::string> Nodes() {
    std::vector<std::string> names;
    for (const ros2::Node& node : graph_.nodes()) names.push_back(node.full_name);
    return names;
  }

  GraphOptions options_;
  std::optional<GraphBuilder> builder_;
  int64_t now_ns_ = 0;
  RosGraph graph_;
  uint64_t version_ = 0;
  std::vector<GraphChange> changes_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_GRAPH_GRAPH_BUILDER_FIXTURE_H_
