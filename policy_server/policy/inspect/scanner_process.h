// Scans payloads with YARA in a process of its own, which is killed when a scan takes too long:
// libyara looks at its clock now and then only, and nothing within the process can stop it.
//
//   the scan                         verdict    the process   its robot
//   ends in time                     its own    stays         pays the time
//   libyara gives up at scan_time    unscanned  stays         pays scan_time
//   is stuck                         unscanned  killed        pays scan_time + kKillGrace, waits
//                                                             (RestartPolicy), alone
//   crashes the process              unscanned  replaced      waits, alone
//   (the process does not come up)   unscanned  tried again   all wait
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_SCANNER_PROCESS_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_SCANNER_PROCESS_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/policy/engine/state/verdict.h"
#include "policy_server/policy/inspect/child_process.h"
#include "policy_server/policy/inspect/message.h"
#include "policy_server/policy/inspect/restart_policy.h"
#include "policy_server/policy/inspect/rule_image.h"
#include "services/base/clock.h"

namespace rips::inspect {

// What libyara gets beyond its time to stop by itself, before it is killed.
inline constexpr absl::Duration kKillGrace = absl::Milliseconds(50);

struct ScannerOptions {
  // A longer payload is unscanned.
  size_t payload_bytes_max = 0;
  absl::Duration scan_time;
  RestartLimits restart;
  // `tasks` does not matter: it cannot start any.
  ChildLimits process;
  Containment contain;
};

// One thread only, which is the thread its process lives with (ChildProcess).
class ScannerProcess {
 public:
  // `clock` is not owned and outlives this; its boottime must really pass.
  ScannerProcess(std::shared_ptr<const RuleImage> rules, ScannerOptions options,
                 const Clock* clock);
  // Kills the process.
  ~ScannerProcess();
  ScannerProcess(const ScannerProcess&) = delete;
  ScannerProcess& operator=(const ScannerProcess&) = delete;

  // Starts the process if none runs, and waits until it has loaded its rules. Errors as
  // ChildProcess::StartScanner.
  absl::Status Start();

  // Whether file `rules` of the image matches `bytes`, a payload of `robot`. Blocks for scan_time +
  // kKillGrace at most, and what it takes to kill and start the process.
  engine::Verdict Scan(uint32_t rules, absl::string_view robot, absl::string_view bytes);

  // Time spent since the last call in starting processes: the robot whose scan waited is not at
  // fault.
  int64_t TakeStartNs() { return std::exchange(start_ns_, 0); }
  uint64_t starts() const { return starts_; }
  uint64_t failures() const { return failures_; }
  // The running process, or 0.
  pid_t pid() const { return process_ == nullptr ? 0 : process_->pid(); }

 private:
  absl::Status MapPayload();
  // The letter, or why there is none.
  absl::StatusOr<char> Exchange(uint32_t rules, size_t bytes);
  void CountFailure(absl::string_view why);
  int64_t Now() const { return clock_->Now().boottime_ns; }

  const std::shared_ptr<const RuleImage> rules_;
  const ScannerOptions options_;
  const Clock* const clock_;  // Not owned; outlives this.
  RestartPolicy restart_;
  UniqueFd payload_fd_;
  char* payload_ = nullptr;  // shared with the process, which can only read it
  std::unique_ptr<ChildProcess> process_;
  int64_t start_ns_ = 0;
  uint64_t starts_ = 0;
  uint64_t failures_ = 0;
  int64_t logged_ns_ = 0;  // 0: never
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_SCANNER_PROCESS_H_
