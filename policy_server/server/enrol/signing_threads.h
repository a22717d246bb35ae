// Threads that wait for signatures, so that a slow certificate authority holds up no call but those
// for certificates.
#ifndef RIPS_POLICY_SERVER_SERVER_ENROL_SIGNING_THREADS_H_
#define RIPS_POLICY_SERVER_SERVER_ENROL_SIGNING_THREADS_H_

#include <functional>
#include <thread>
#include <utility>
#include <vector>

#include "absl/time/time.h"
#include "services/runtime/bounded_queue.h"

namespace rips::enrol {

// Any thread.
class SigningThreads {
 public:
  // Tasks that wait at most.
  static constexpr size_t kWaitingMax = 64;

  // `count` tasks run at a time, the oldest first.
  explicit SigningThreads(int count) {
    for (int i = 0; i < count; ++i) threads_.emplace_back([this] { Run(); });
  }
  // Runs what waits.
  ~SigningThreads() {
    tasks_.Close();
    for (std::thread& each : threads_) each.join();
  }
  SigningThreads(const SigningThreads&) = delete;
  SigningThreads& operator=(const SigningThreads&) = delete;

  // False if kWaitingMax wait already. Never blocks.
  bool Push(std::function<void()> task) { return tasks_.Push(std::move(task)); }

 private:
  void Run() {
    while (auto task = tasks_.Pop(absl::InfiniteDuration())) (*task)();
  }

  BoundedQueue<std::function<void()>> tasks_{{.capacity = kWaitingMax}};
  std::vector<std::thread> threads_;
};

}  // namespace rips::enrol

#endif  // RIPS_POLICY_SERVER_SERVER_ENROL_SIGNING_THREADS_H_
