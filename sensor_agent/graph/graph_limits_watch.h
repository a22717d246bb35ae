// Whether a limit has left something out of the sensor's graph, and when to ask discovery for it
// again. Pure; header only.
#ifndef RIPS_SENSOR_AGENT_GRAPH_GRAPH_LIMITS_WATCH_H_
#define RIPS_SENSOR_AGENT_GRAPH_GRAPH_LIMITS_WATCH_H_

#include <algorithm>
#include <cstdint>

#include "services/base/clock.h"

namespace rips::sensor {

//   whole ──left out──► short ──room for kRoomNs, or kAskAgainNs──► asking
//     ▲                   ▲──────────────left out──────────────────────┤
//     └──────────────────kAnswerNs, nothing left out───────────────────┘
class GraphLimitsWatch {
 public:
  // Without room, between two times that discovery is asked for everything.
  static constexpr int64_t kAskAgainNs = 60 * kNanosPerSecond;
  // With room: so long since something was left out, doubled each time up to kAskAgainNs. It starts
  // over when the graph has been whole for kAskAgainNs.
  static constexpr int64_t kRoomNs = 3 * kNanosPerSecond;
  // By then it has answered.
  static constexpr int64_t kAnswerNs = 5 * kNanosPerSecond;

  // `left_out` since the last call; `has_room`: the tables are not nearly full. Times never go
  // back. True: ask discovery now.
  bool Look(uint64_t left_out, bool has_room, int64_t now_ns) {
    if (left_out > 0) {
      if (!short_ && now_ns - whole_since_ns_ >= kAskAgainNs) room_ns_ = kRoomNs;
      short_ = true;
      asking_ = false;
      last_left_out_ns_ = now_ns;
      return false;
    }
    if (!short_) return false;
    const int64_t quiet_ns = now_ns - last_left_out_ns_;
    if (asking_) {
      if (now_ns < answered_ns_) return false;
      short_ = asking_ = false;
      whole_since_ns_ = now_ns;
      return false;
    }
    if (quiet_ns < (has_room ? room_ns_ : kAskAgainNs)) return false;
    room_ns_ = std::min(2 * room_ns_, kAskAgainNs);
    asking_ = true;
    answered_ns_ = now_ns + kAnswerNs;
    return true;
  }
  // Discovery was asked for everything for another reason.
  void Asked(int64_t now_ns) {
    if (!short_) return;
    asking_ = true;
    answered_ns_ = now_ns + kAnswerNs;
  }
  // The graph lacks something that was discovered.
  bool is_short() const { return short_; }

 private:
  bool short_ = false;
  bool asking_ = false;
  int64_t last_left_out_ns_ = 0;
  int64_t answered_ns_ = 0;
  int64_t whole_since_ns_ = 0;
  int64_t room_ns_ = kRoomNs;
};

}  // namespace rips::sensor

#endif  // RIPS_SENSOR_AGENT_GRAPH_GRAPH_LIMITS_WATCH_H_
