// What is seen of one robot and what is not, as operators are told. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_COVERAGE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_COVERAGE_H_

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/container/btree_map.h"
#include "absl/container/btree_set.h"
#include "absl/strings/string_view.h"
#include "policy_server/server/robot/model/inbound.h"
#include "services/base/clock.h"
#include "services/ros2/guid.h"
#include "services/ros2/ros_graph.h"

namespace rips::pipeline {

// One sensor host of the inventory.
struct SensorCoverage {
  std::string host;
  bool primary = false;
  bool connected = false;
  // Its graph and messages are judged; it is past its discovery.
  bool settled = false;
  // As the sensor said last. `not_visible` is what it said last in whatever message.
  SensorStateSeen state;
  // In the last ten minutes (RecentLosses).
  uint64_t lost = 0;
  // Its wall clock minus the server's; nullopt = not known.
  std::optional<int64_t> clock_skew_ns;
};

// What a sensor does about the interest it was sent.
struct SensorInterest {
  std::string host;
  bool connected = false;
  bool in_use = false;
  // Why not, if it said; printable.
  std::string problem;
};

struct EndpointCounts {
  size_t watched = 0;
  size_t not_needed = 0;
  size_t not_visible = 0;

  friend bool operator==(const EndpointCounts&, const EndpointCounts&) = default;
};

// Services and their clients: nobody reads their requests, since one more reader would make clients
// wait for ever. They are known by discovery, as they are meant to be.
bool NeverRead(const ros2::Endpoint& endpoint);

// Endpoints of `graph` by visibility, without those that are never read and those of `own`
// participants.
EndpointCounts CountEndpoints(const ros2::RosGraph& graph,
                              const std::vector<ros2::Guid>& own_participants);

// Tells when less is seen than was told last: endpoints that are not visible, and kinds of traffic
// that a sensor cannot see. What changes in between is told together.
class CoverageAlarm {
 public:
  // Between two alarms, so that what comes and goes does not fill the log.
  static constexpr int64_t kEveryNs = 60 * kNanosPerSecond;
  // Kinds of one sensor that are remembered and told; more are not.
  static constexpr size_t kKindsMax = 64;
  static constexpr size_t kKindBytesMax = 200;

  void SetNotVisible(size_t endpoints) { not_visible_ = endpoints; }
  // What the sensor says for the first time is no fall.
  void SetKinds(const std::string& host, const std::vector<std::string>& kinds);

  // What has fallen since it was told last, printable; nullopt if nothing has, or it is too soon.
  std::optional<std::string> Due(int64_t now_ns);

 private:
  struct Kinds {
    absl::btree_set<std::string> now;
    absl::btree_set<std::string> told;
  };

  size_t not_visible_ = 0;
  size_t told_not_visible_ = 0;
  absl::btree_map<std::string, Kinds> kinds_;
  std::optional<int64_t> told_ns_;
};

// Topics of which payloads were longer than the sensor sends.
class CutPayloads {
 public:
  // A topic is forgotten this long after the last one.
  static constexpr int64_t kKeptNs = 600 * kNanosPerSecond;
  // Further topics are not told apart: they take the place of the one whose last is oldest.
  static constexpr size_t kTopicsMax = 64;

  struct Topic {
    std::string topic;
    // Bytes of the last one that came.
    uint32_t limit_bytes = 0;
    // Of the longest one on the robot.
    uint32_t longest_bytes = 0;
    // Messages since the first of them.
    uint64_t count = 0;
    int64_t last_ns = 0;
  };

  void Add(absl::string_view topic, uint32_t came_bytes, uint32_t size_bytes, int64_t now_ns);
  // By name.
  std::vector<Topic> Recent(int64_t now_ns) const;

 private:
  absl::btree_map<std::string, Topic> topics_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_COVERAGE_H_
