// Whether a limit has left something out of the sensor's graph, and when to ask discovery for it
// again. Pure; header only.
#ifndef RIPS_SENSOR_AGENT_GRAPH_LIMITS_WATCH_H_
#define RIPS_SENSOR_AGENT_GRAPH_LIMITS_WATCH_H_

#include <cstdint>

#include "services/base/clock.h"

namespace rips::sensor {

//   whole ──left out──► short ──kAskAgainNs──► asking ──kAnswerNs, nothing left out──► whole
//                         ▲────────────────left out─────┘
class GraphLimitsWatch {
 public:
  // Between two times that discovery is asked for everything.
  static constexpr int64_t kAskAgainNs = 60 * kNanosPerSecond;
  // By then it has answered.
  static constexpr int64_t kAnswerNs = 5 * kNanosPerSecond;

  // `left_out` since the last call; times never go back. True: ask discovery now.
  bool Look(uint64_t left_out, int64_t now_ns) {
    if (left_out > 0) {
      short_ = true;
      asking_ = false;
      due_ns_ = now_ns + kAskAgainNs;
      return false;
    }
    if (!short_ || now_ns < due_ns_) return false;
    if (asking_) {
      short_ = asking_ = false;
      return false;
    }
    asking_ = true;
    due_ns_ = now_ns + kAnswerNs;
    return true;
  }
  // The graph lacks something that was discovered.
  bool is_short() const { return short_; }

 private:
  bool short_ = false;
  bool asking_ = false;
  int64_t due_ns_ = 0;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_GRAPH_LIMITS_WATCH_H_
