// How a simulated robot gets where it is sent: its navigator plans the shortest way over the floor
// as it is now and steers along it; its base, which can drive in any direction, goes as it was told
// last. Pure: no clock, no DDS; times are nanoseconds of one clock.
#ifndef RIPS_TESTS_SUPPORT_ROBOT_SIM_PATROL_H_
#define RIPS_TESTS_SUPPORT_ROBOT_SIM_PATROL_H_

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/status.h"
#include "tests/support/robot_sim/floor.h"
#include "tests/support/robot_sim/ros_messages.h"

namespace rips::robot_sim {

// Not thread-safe.
class Patrol {
 public:
  // At the first place of the floor.
  explicit Patrol(Floor floor);

  // NotFound if the floor has no such place.
  absl::Status Send(const std::string& place);
  // A person begins to walk; who walks already begins anew.
  void SendPerson(int64_t now_ns) { person_since_ns_ = now_ns; }

  // The navigator's next command: at most `max_speed` m/s; none if it is there or there is no way.
  Twist Steer(int64_t now_ns, bool keep_out, double max_speed) const;
  // The base goes at `speed` (m/s, along x and y of the map) until `now_ns`.
  void Drive(int64_t now_ns, const Twist& speed);
  // The costmap as it is now.
  std::string Grid(int64_t now_ns, bool keep_out) const;

  const Floor& floor() const { return floor_; }
  // Metres.
  Floor::Point at() const { return at_; }

 private:
  InTheWay Now(int64_t now_ns, bool keep_out) const;

  const Floor floor_;
  Floor::Point at_;
  std::optional<Cell> goal_;
  std::optional<int64_t> person_since_ns_;
  int64_t driven_ns_ = 0;  // 0 = not yet
};

}  // namespace rips::robot_sim

#endif  // RIPS_TESTS_SUPPORT_ROBOT_SIM_PATROL_H_
