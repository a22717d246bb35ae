// Whether the sequence numbers that are on the wire under a writer's name may be those of one
// writer. A writer counts its samples from 1; HEARTBEAT and GAP speak of numbers that it has given.
//
// | not of one writer                                                       | because            |
// |-------------------------------------------------------------------------|--------------------|
// | a number kJump, and kRateMax for each second, above the last one        | none writes so     |
// |                                                                         | fast               |
// | the last number by HEARTBEAT more than kHeartbeatBack below one that    | it never goes back |
// | was on the wire in an earlier interval                                  |                    |
// | DATA more than kJump below such a number, of a writer without keys      | no history is so   |
// |                                                                         | long               |
// | numbers of the first interval that are so far apart                     | likewise           |
//
// A topic with keys keeps old samples of keys that do not change, so that its history may be long.
#ifndef RIPS_SENSOR_AGENT_WIRE_WRITER_NUMBERS_H_
#define RIPS_SENSOR_AGENT_WIRE_WRITER_NUMBERS_H_

#include <cstdint>
#include <string>

#include "sensor_agent/wire/traffic.h"

namespace rips::wire {

// Of one writer. Not thread-safe; times are CLOCK_BOOTTIME in nanoseconds and never go back.
class WriterNumbers {
 public:
  static constexpr uint64_t kJump = 1'000'000;
  static constexpr uint64_t kRateMax = 5'000'000;
  // Threads of a writer may overtake each other.
  static constexpr uint64_t kHeartbeatBack = 64;

  // Why not, human-readable, and begins anew; empty = they may be.
  std::string Take(const Traffic& traffic, int64_t now_ns);

 private:
  // The highest number of earlier intervals, and when it came. 0 = none yet.
  uint64_t highest_ = 0;
  int64_t highest_ns_ = 0;
};

}  // namespace rips::wire

#endif  // RIPS_SENSOR_AGENT_WIRE_WRITER_NUMBERS_H_
