// Between the thread that talks to a device, which may block, and those that wait for it.
#ifndef RIPS_MODE_ACTUATOR_STEPS_ALARM_IO_GATE_H_
#define RIPS_MODE_ACTUATOR_STEPS_ALARM_IO_GATE_H_

#include <optional>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {

// Any thread.
class IoGate {
 public:
  // `clock` is not owned and outlives this.
  explicit IoGate(const Clock* clock) : clock_(clock) {}

  // One exchange that may block:
  //   IoGate::Exchange exchange(gate);
  //   RIPS_RETURN_IF_ERROR(exchange.status());  // Aborted: no caller waits for it any more
  class [[nodiscard]] Exchange {
   public:
    explicit Exchange(IoGate* gate) : gate_(gate), status_(gate->Enter()) {}
    ~Exchange() { gate_->Leave(); }
    Exchange(const Exchange&) = delete;
    Exchange& operator=(const Exchange&) = delete;
    const absl::Status& status() const { return status_; }

   private:
    IoGate* const gate_;  // Not owned; outlives this.
    const absl::Status status_;
  };

  // How long the present exchange has taken; zero if there is none.
  absl::Duration Busy() const ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (!began_ns_.has_value()) return absl::ZeroDuration();
    return absl::Nanoseconds(clock_->Now().boottime_ns - *began_ns_);
  }
  // Every later exchange is Aborted, until Open().
  void Close() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    closed_ = true;
  }
  void Open() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    closed_ = false;
  }

 private:
  absl::Status Enter() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (closed_) return absl::AbortedError("given up");
    began_ns_ = clock_->Now().boottime_ns;
    return absl::OkStatus();
  }
  void Leave() ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    began_ns_.reset();
  }

  const Clock* const clock_;  // Not owned; outlives this.
  mutable Mutex mu_;
  bool closed_ ABSL_GUARDED_BY(mu_) = false;
  std::optional<int64_t> began_ns_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_ALARM_IO_GATE_H_
