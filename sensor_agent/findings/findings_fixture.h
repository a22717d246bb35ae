// Findings under a stepped time and a graph that the test plays.
#ifndef RIPS_SENSOR_AGENT_FINDINGS_FINDINGS_FIXTURE_H_
#define RIPS_SENSOR_AGENT_FINDINGS_FINDINGS_FIXTURE_H_

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "sensor_agent/findings/findings.h"

namespace rips::sensor {

using ros2::Endpoint;
using ros2::EndpointKind;
using ros2::GraphDelta;
using ros2::Guid;

inline constexpr int64_t kMs = 1'000'000;
inline constexpr int64_t kSecond = 1'000 * kMs;

inline Guid ParticipantGuid(uint16_t number, uint8_t first = 0x01) {
  Guid guid;
  guid.bytes = {first,
                0x10,
                0,
                0,
                0,
                0,
                0,
                0,
                0,
                0,
                static_cast<uint8_t>(number >> 8),
                static_cast<uint8_t>(number),
                0,
                0,
                1,
                0xc1};
  return guid;
}

inline Guid EndpointGuid(uint16_t participant, uint8_t number, bool writer = true) {
  Guid guid = ParticipantGuid(participant);
  guid.bytes[14] = number;
  guid.bytes[15] = writer ? 0x03 : 0x04;
  return guid;
}

inline constexpr uint16_t kOwn = 200;
inline constexpr uint16_t kActuator = 201;

inline auto Begins(const std::string& kind, const testing::Matcher<Guid>& guid) {
  return ::testing::AllOf(::testing::Field("kind", &Finding::kind, kind),
                          ::testing::Field("guid", &Finding::guid, guid),
                          ::testing::Field("over", &Finding::over, false));
}
inline auto Ends(const std::string& kind, const testing::Matcher<Guid>& guid) {
  return ::testing::AllOf(::testing::Field("kind", &Finding::kind, kind),
                          ::testing::Field("guid", &Finding::guid, guid),
                          ::testing::Field("over", &Finding::over, true));
}

// Steps time and plays the steps of a graph.
class FindingsTest : public testing::Test {
 protected:
  FindingsTest() { Restart({}); }

  void Restart(FindingsOptions options) {
    options.own = ParticipantGuid(kOwn);
    findings_.emplace(std::move(options));
    version_ = 0;
    Step({});
    findings_->SetConnected(true, now_ns_);
    EXPECT_THAT(Poll(), ::testing::IsEmpty());
  }
  void Step(GraphDelta delta) {
    GraphChange change{.from_version = version_, .settled = true, .delta = std::move(delta)};
    change.to_version = ++version_;
    findings_->OnGraph(change, now_ns_);
  }
  std::vector<Finding> Poll() { return findings_->Poll(now_ns_); }
  std::vector<Finding> After(int64_t ns) {
    now_ns_ += ns;
    return Poll();
  }

  static GraphDelta Process(uint16_t number, const std::string& node = "") {
    GraphDelta delta;
    delta.upsert_participants.push_back({.guid = ParticipantGuid(number), .host = "h", .pid = 7});
    if (!node.empty()) {
      delta.upsert_nodes.push_back({.full_name = node, .participant = ParticipantGuid(number)});
    }
    // The writer of ros_discovery_info.
    delta.upsert_endpoints.push_back(
        {.guid = EndpointGuid(number, 1), .name = "ros_discovery_info", .ros = false});
    return delta;
  }
  static Endpoint Client(uint16_t participant, uint8_t number, const std::string& service) {
    return {.guid = EndpointGuid(participant, number),
            .kind = EndpointKind::kClient,
            .name = service,
            .type = "t"};
  }
  static Endpoint Service(uint16_t participant, uint8_t number, const std::string& service,
                          const std::string& node = "/safety", bool pending = false) {
    return {.guid = EndpointGuid(participant, number, /*writer=*/false),
            .kind = EndpointKind::kService,
            .name = service,
            .type = "t",
            .node = node,
            .pending = pending};
  }
  static Endpoint Publisher(uint16_t participant, uint8_t number, const std::string& node,
                            bool pending = false) {
    return {.guid = EndpointGuid(participant, number),
            .name = "/cmd_vel",
            .type = "t",
            .node = node,
            .pending = pending};
  }
  void Gone(const Guid& guid) { Step({.gone_guids = {guid}}); }
  void StartManager(uint16_t participant = 1) {
    GraphDelta delta = Process(participant, "/safety");
    delta.upsert_endpoints.push_back(Service(participant, 2, "/safety/change_mode"));
    delta.upsert_endpoints.push_back(Service(participant, 3, "/camera/change_mode"));
    // It steers the nodes below it.
    delta.upsert_endpoints.push_back(Client(participant, 4, "/camera/change_state"));
    Step(std::move(delta));
  }

  int64_t now_ns_ = 1'000 * kSecond;
  uint64_t version_ = 0;
  std::optional<Findings> findings_;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_FINDINGS_FINDINGS_FIXTURE_H_
