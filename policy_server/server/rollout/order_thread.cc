#include "policy_server/server/rollout/order_thread.h"

#include <memory>
#include <optional>
#include <utility>

namespace rips::rollout {

void OrderThread::Start(std::function<void()> look) {
  thread_ = std::thread([this, look = std::move(look)] { Run(look); });
}

void OrderThread::Stop() {
  orders_.Close();
  if (thread_.joinable()) thread_.join();
}

void OrderThread::Run(const std::function<void()>& look) {
  Instant looked = clock_->Now();
  while (true) {
    if (const std::optional<std::function<void()>> order = orders_.Pop(kInterval)) {
      (*order)();
    } else if (orders_.closed()) {
      return;
    }
    const Instant now = clock_->Now();
    if (now.boottime_ns - looked.boottime_ns < absl::ToInt64Nanoseconds(kInterval)) continue;
    looked = now;
    look();
  }
}

bool OrderThread::Await(std::function<void()> order) {
  const auto done =
      std::make_shared<BoundedQueue<bool>>(BoundedQueue<bool>::Options{.capacity = 1});
  const bool posted = Post([done, order = std::move(order)] {
    order();
    done->Push(true);
  });
  if (posted) done->Pop(absl::InfiniteDuration());
  return posted;
}

}  // namespace rips::rollout
