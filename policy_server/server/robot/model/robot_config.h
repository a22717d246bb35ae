// What a robot of the inventory is, and the times that the server keeps with it.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ROBOT_CONFIG_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ROBOT_CONFIG_H_

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "services/base/clock.h"
#include "services/base/config_setting.h"
#include "services/ros2/graph_limits.h"

namespace rips::pipeline {

struct RobotConfig {
  std::string id;
  // From the inventory. At most one sensor host is primary: graph and messages are its alone.
  std::vector<std::string> sensor_hosts;
  std::string primary_sensor;
  std::vector<std::string> actuator_hosts;
  ros2::GraphLimits graph_limits;
  // What its sensors are to follow of their configuration.
  std::vector<ConfigSetting> sensor_settings;
};

// True if the same agents are listed, with the same parts.
inline bool SameHosts(const RobotConfig& a, const RobotConfig& b) {
  return a.sensor_hosts == b.sensor_hosts && a.primary_sensor == b.primary_sensor &&
         a.actuator_hosts == b.actuator_hosts && a.graph_limits == b.graph_limits;
}

// Named as the rule of what RIPS says by itself.
inline constexpr absl::string_view kOwnRule = "(rips)";

// What is kept of an alert; longer texts end in `...`. A rule's: a string of 4,096 code points.
inline constexpr size_t kAlertTextBytesMax = size_t{16} << 10;
inline constexpr size_t kAlertEventBytesMax = size_t{1} << 10;
// What RIPS says by itself, much of it in an agent's words.
inline constexpr size_t kOwnAlertBytesMax = size_t{4} << 10;

struct Timing {
  int64_t heartbeat_ns = 500 * kNanosPerMilli;
  int64_t stale_ns = 1'500 * kNanosPerMilli;
  int64_t lost_ns = 5 * kNanosPerSecond;
  int64_t lease_ns = 15 * kNanosPerSecond;
  int64_t drain_lease_ns = 60 * kNanosPerSecond;
  int64_t late_after_ns = 5 * kNanosPerSecond;
  int64_t backlog_ns = 1 * kNanosPerSecond;
  // A message waits so long for the version of the graph that it names, then it is judged without:
  // the sensor's attribution grace of 500 ms, and as long as a busy robot may take for the rest.
  int64_t graph_wait_ns = 1'500 * kNanosPerMilli;
  int64_t tick_ns = 200 * kNanosPerMilli;
  int64_t checkpoint_ns = 1 * kNanosPerSecond;
  uint32_t linger_ms = 20;
  // A sensor may have this many bytes of message batches not yet judged.
  uint64_t credit_bytes = 1 << 20;
  // And this many of payloads in chunks. When all else is judged, more than half of it is free: the
  // largest payload (kPayloadBytesHard) must fit.
  uint64_t payload_credit_bytes = 8 << 20;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_MODEL_ROBOT_CONFIG_H_
