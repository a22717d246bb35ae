// What the server finds out about one sensor from outside: how its clock runs, how often it starts
// anew, how much it loses. Pure; times are the server's.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SENSOR_HEALTH_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SENSOR_HEALTH_H_

#include <cstddef>
#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <utility>

#include "absl/strings/string_view.h"
#include "policy_server/server/robot/model/inbound.h"
#include "services/base/clock.h"

namespace rips::pipeline {

// The sensor's wall clock minus the server's. A heartbeat was sent at some time between the
// server's heartbeat that it echoes and its arrival, so each one bounds the difference from both
// sides.
class ClockSkew {
 public:
  // A clock is off when it is further off than this for so many heartbeats in a row.
  static constexpr int64_t kOffNs = 500 * kNanosPerMilli;
  static constexpr int kOffHeartbeats = 3;
  // Heartbeats of which the closest is the estimate.
  static constexpr size_t kHeartbeatsKept = 8;

  // True if the clock is found off now and was not before. A clock that is behind is found off only
  // where the time since the echoed heartbeat, up to a heartbeat, does not explain it.
  bool Heartbeat(const SensorHeartbeat& heartbeat, Instant now);

  // Nanoseconds; nullopt before the first heartbeat. Too low by the way of a heartbeat.
  std::optional<int64_t> estimate_ns() const;
  bool off() const { return off_; }

 private:
  std::deque<int64_t> lower_bounds_ns_;
  int heartbeats_off_ = 0;
  bool off_ = false;
};

// The server's CLOCK_BOOTTIME minus the sensor's: the least that the newest heartbeats allow, which
// is too high by the way of the fastest of them.
class BoottimeOffset {
 public:
  static constexpr size_t kHeartbeatsKept = 16;

  void Heartbeat(int64_t sent_ns, int64_t now_ns);
  // nullopt before the first heartbeat.
  std::optional<int64_t> ns() const;

 private:
  std::deque<int64_t> newest_ns_;
};

// Processes of one sensor, by incarnation.
class RestartCount {
 public:
  // So many new incarnations after the first within so long are too many.
  static constexpr size_t kRestartsMax = 3;
  static constexpr int64_t kWithinNs = 600 * kNanosPerSecond;

  // A session of `incarnation` begins. True if that is one restart too many; then counting begins
  // anew. An incarnation that was seen last is no restart.
  bool Began(absl::string_view incarnation, int64_t now_ns);
  // One restart until then is ours: it follows other settings.
  void Expect(int64_t until_ns) { expected_until_ns_ = until_ns; }

 private:
  std::string last_;
  int64_t expected_until_ns_ = 0;
  std::deque<int64_t> restarts_ns_;
};

// How much was lost lately, in steps of kStepNs.
class RecentLosses {
 public:
  static constexpr int64_t kWithinNs = 600 * kNanosPerSecond;
  static constexpr int64_t kStepNs = 10 * kNanosPerSecond;

  // Times never go back. Counts stop at the largest number.
  void Add(uint64_t count, int64_t now_ns);
  // Of the last kWithinNs, and at most a step more.
  uint64_t Total(int64_t now_ns) const;

 private:
  // Start of the step, and what was lost in it.
  std::deque<std::pair<int64_t, uint64_t>> steps_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_SENSORS_SENSOR_HEALTH_H_
