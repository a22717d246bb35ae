// What all parties of a simulation share: time, the checker, the trace, and the planted fault.
#ifndef RIPS_TESTS_SIMULATION_CONTEXT_H_
#define RIPS_TESTS_SIMULATION_CONTEXT_H_

#include <array>
#include <cstdint>
#include <deque>
#include <string>

#include "absl/strings/str_format.h"
#include "absl/strings/string_view.h"
#include "tests/simulation/invariants.h"
#include "tests/simulation/scheduler.h"

namespace rips::simulation {

// A fault in the wiring that breaks one invariant on purpose.
enum class Fault {
  kNone,
  kEarlyLowering,         // the store reports a lowering as durable before it is
  kStaleTerm,             // a late command of an old term reaches the actuator with the newest term
  kEarlyAcknowledgement,  // the store reports judged sequences as durable before they are
  kIgnoredLease,          // the end of the lease does not reach the actuator
  kJudgedTwice,           // what a sensor sends again carries new numbers
};
inline constexpr std::array<absl::string_view, 6> kFaultNames = {
    "none",          "early-lowering", "stale-term", "early-acknowledgement",
    "ignored-lease", "judged-twice"};

// The newest events, one line each.
class Trace {
 public:
  static constexpr size_t kLines = 40;
  explicit Trace(const Scheduler* scheduler) : scheduler_(scheduler) {}

  void Add(absl::string_view party, absl::string_view what) {
    const double seconds =
        static_cast<double>(scheduler_->now_ns()) / static_cast<double>(kNanosPerSecond);
    lines_.push_back(absl::StrFormat("%10.4f s  %-8s  %s", seconds - 1'000, party, what));
    if (lines_.size() > kLines) lines_.pop_front();
  }
  const std::deque<std::string>& lines() const { return lines_; }

 private:
  const Scheduler* scheduler_;
  std::deque<std::string> lines_;
};

struct Context {
  Context(uint64_t seed, Fault planted) : scheduler(seed), trace(&scheduler), fault(planted) {}

  Scheduler scheduler;
  Checker checker;
  Trace trace;
  Fault fault;
};

}  // namespace rips::simulation

#endif  // RIPS_TESTS_SIMULATION_CONTEXT_H_
