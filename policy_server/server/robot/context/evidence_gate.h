// Whether a soft lowering may be believed: everything that could hide an attack must have been in
// order for `hold` without a break. A level cannot sink because nobody is looking.
#ifndef RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_EVIDENCE_GATE_H_
#define RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_EVIDENCE_GATE_H_

#include <cstdint>
#include <string>
#include <vector>

#include "policy_server/policy/levels/level_machine.h"
#include "services/base/clock.h"

namespace rips::pipeline {

// Not thread-safe. Time is CLOCK_BOOTTIME.
class EvidenceGate {
 public:
  EvidenceGate(int64_t hold_ns, Instant now)
      : hold_ns_(hold_ns), clear_since_ns_(now.boottime_ns) {}

  // What is wrong right now; empty = nothing. Any entry starts the hold anew, and so does a level
  // that is not verified.
  void Update(std::vector<std::string> problems, bool level_verified, Instant now);
  // Something happened that spoils evidence although it is over already (a loss, a late batch).
  void Disturb(const std::string& why, Instant now);
  // Something bad was seen: what was decided before and is still being recorded did not know of it.
  // The hold goes on, since it was seen.
  void Contradict(const std::string& why) { broken_by_ = why; }
  // The level has changed: nothing is wrong, and what was seen before says nothing about it.
  void Restart(Instant now);

  // Empty blind_because = complete for the whole hold.
  levels::Evidence Assess(Instant now) const;
  // What has been wrong since Restart, or was seen since then; the newest of it. Empty = nothing.
  const std::string& broken_by() const { return broken_by_; }
  // Nothing is wrong now, whatever the hold.
  bool complete_now() const { return problems_.empty(); }
  void set_hold_ns(int64_t hold_ns) { hold_ns_ = hold_ns; }

 private:
  int64_t hold_ns_;
  std::vector<std::string> problems_;
  int64_t clear_since_ns_;
  // Why the hold was last started anew.
  std::string disturbed_by_ = "the server started";
  std::string broken_by_;
};

}  // namespace rips::pipeline

#endif  // RIPS_POLICY_SERVER_SERVER_ROBOT_CONTEXT_EVIDENCE_GATE_H_
