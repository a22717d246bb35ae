// A thread that runs orders one at a time, and looks around once a second.
#ifndef RIPS_POLICY_SERVER_SERVER_ROLLOUT_ORDER_THREAD_H_
#define RIPS_POLICY_SERVER_SERVER_ROLLOUT_ORDER_THREAD_H_

#include <cstddef>
#include <functional>
#include <thread>

#include "absl/time/time.h"
#include "services/base/clock.h"
#include "services/runtime/bounded_queue.h"

namespace rips::rollout {

class OrderThread {
 public:
  // Orders that wait; one more is refused.
  static constexpr size_t kOrdersMax = 64;
  static constexpr absl::Duration kInterval = absl::Seconds(1);

  // `clock` is not owned and outlives this.
  explicit OrderThread(const Clock* clock) : clock_(clock) {}
  ~OrderThread() { Stop(); }

  // Once. `look` is called on the thread.
  void Start(std::function<void()> look);
  // Ends it; orders that wait are run first. Idempotent.
  void Stop();
  // Runs the order after those before it. False: too many wait, or it has ended. Any thread.
  bool Post(std::function<void()> order) { return orders_.Push(std::move(order)); }
  // Orders that wait now. Any thread.
  size_t waiting() const { return orders_.size(); }
  // As Post, and waits for it. Not from the thread.
  bool Await(std::function<void()> order);

 private:
  void Run(const std::function<void()>& look);

  const Clock* clock_;
  BoundedQueue<std::function<void()>> orders_{{.capacity = kOrdersMax}};
  std::thread thread_;
};

}  // namespace rips::rollout

#endif  // RIPS_POLICY_SERVER_SERVER_ROLLOUT_ORDER_THREAD_H_
