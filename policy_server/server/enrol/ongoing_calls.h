// Calls of which each may run once at a time.
#ifndef RIPS_POLICY_SERVER_SERVER_ENROL_ONGOING_CALLS_H_
#define RIPS_POLICY_SERVER_SERVER_ENROL_ONGOING_CALLS_H_

#include <memory>
#include <set>
#include <string>
#include <utility>

#include "absl/base/thread_annotations.h"
#include "services/runtime/mutex.h"

namespace rips::enrol {

// Any thread.
class OngoingCalls {
 public:
  // Until it is destroyed, there is no other of the same text.
  class Claim {
   public:
    ~Claim() { calls_->Release(what_); }
    Claim(const Claim&) = delete;
    Claim& operator=(const Claim&) = delete;

   private:
    friend class OngoingCalls;
    Claim(OngoingCalls* calls, std::string what) : calls_(calls), what_(std::move(what)) {}

    OngoingCalls* const calls_;
    const std::string what_;
  };
  // Null if there is one. This outlives it.
  std::unique_ptr<Claim> TryClaim(const std::string& what) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    if (!claimed_.insert(what).second) return nullptr;
    return std::unique_ptr<Claim>(new Claim(this, what));
  }

 private:
  void Release(const std::string& what) ABSL_LOCKS_EXCLUDED(mu_) {
    MutexLock lock(&mu_);
    claimed_.erase(what);
  }

  Mutex mu_;
  std::set<std::string> claimed_ ABSL_GUARDED_BY(mu_);
};

}  // namespace rips::enrol

#endif  // RIPS_POLICY_SERVER_SERVER_ENROL_ONGOING_CALLS_H_
