// Time and chance of a simulation: one queue of tasks, one clock, one seeded generator. The same
// seed gives the same run.
#ifndef RIPS_TESTS_SIMULATION_SCHEDULER_H_
#define RIPS_TESTS_SIMULATION_SCHEDULER_H_

#include <algorithm>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <random>
#include <utility>

#include "services/base/fake_clock.h"

namespace rips::simulation {

inline constexpr int64_t kMs = kNanosPerMilli;

class Scheduler {
 public:
  explicit Scheduler(uint64_t seed) : random_(seed) {}

  // Tasks of one instant run in the order in which they were given.
  void After(int64_t delay_ns, std::function<void()> task) {
    tasks_.emplace(std::pair(now_ns() + std::max<int64_t>(delay_ns, 0), ++order_), std::move(task));
  }
  // Moves the clock to the earliest task and runs it.
  void Step() {
    auto first = tasks_.begin();
    clock_.Advance(first->first.first - now_ns());
    const std::function<void()> task = std::move(first->second);
    tasks_.erase(first);
    task();
  }

  FakeClock& clock() { return clock_; }
  int64_t now_ns() const { return clock_.Now().boottime_ns; }

  // Of [low, high].
  int64_t Between(int64_t low, int64_t high) {
    return low + static_cast<int64_t>(random_() % static_cast<uint64_t>(high - low + 1));
  }
  bool Chance(unsigned percent) { return random_() % 100 < percent; }

 private:
  std::mt19937_64 random_;
  FakeClock clock_;
  std::map<std::pair<int64_t, uint64_t>, std::function<void()>> tasks_;
  uint64_t order_ = 0;
};

// One direction of a stream: in order, delayed, and without its tail when the stream breaks.
class Line {
 public:
  explicit Line(Scheduler* scheduler) : scheduler_(scheduler) {}
  ~Line() { Cut(); }
  Line(const Line&) = delete;
  Line& operator=(const Line&) = delete;

  void Send(std::function<void()> deliver) {
    if (!*open_) return;
    const bool slow = scheduler_->Chance(3);
    const int64_t delay_ns =
        slow ? scheduler_->Between(50, 900) * kMs : scheduler_->Between(200, 8'000) * 1'000;
    last_ns_ = std::max(last_ns_, scheduler_->now_ns() + delay_ns);
    scheduler_->After(last_ns_ - scheduler_->now_ns(),
                      [open = open_, deliver = std::move(deliver)] {
                        if (*open) deliver();
                      });
  }
  void Cut() { *open_ = false; }

 private:
  Scheduler* scheduler_;
  std::shared_ptr<bool> open_ = std::make_shared<bool>(true);
  int64_t last_ns_ = 0;
};

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_SCHEDULER_H_
