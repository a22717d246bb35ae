// When a thread calls OnTime of which robots: of few in one go each step, of many in parts of a
// step, so that no task waits for all of them. Pure.
#ifndef RIPS_POLICY_SERVER_SERVER_SHARD_TIME_ROUNDS_H_
#define RIPS_POLICY_SERVER_SERVER_SHARD_TIME_ROUNDS_H_

#include <algorithm>
#include <cstddef>
#include <cstdint>

namespace rips::pipeline {

// Not thread-safe.
class TimeRounds {
 public:
  static constexpr size_t kRobotsOfPart = 32;
  static constexpr size_t kPartsMax = 10;

  explicit TimeRounds(int64_t step_ns) : step_ns_(step_ns) {}

  // Of a robot that joins: where in the rounds it is, for as long as it stays.
  size_t Join() { return joined_++; }
  // Begins the next part. A late part includes the parts that were missed, up to the end of the
  // round: no robot is in one part twice.
  void Next(size_t robots, int64_t late_ns) {
    if (round_over()) {
      parts_ = std::clamp<size_t>(robots / kRobotsOfPart, 1, kPartsMax);
      end_ = 0;
    }
    begin_ = end_;
    const int64_t missed = std::max<int64_t>(late_ns, 0) / part_ns();
    end_ = begin_ + 1 + static_cast<size_t>(std::min<int64_t>(missed, kPartsMax));
  }
  // A robot that joined as `joined` belongs to this part.
  bool Contains(size_t joined) const {
    const size_t part = joined % parts_;
    return begin_ <= part && part < end_;
  }
  // This part is the last of its round.
  bool round_over() const { return end_ >= parts_; }
  // From the end of a part to the next.
  int64_t part_ns() const { return step_ns_ / static_cast<int64_t>(parts_); }

 private:
  const int64_t step_ns_;
  size_t joined_ = 0;
  size_t parts_ = 1;
  // Of the parts of this round, those under way.
  size_t begin_ = 0;
  size_t end_ = 1;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_SHARD_TIME_ROUNDS_H_
