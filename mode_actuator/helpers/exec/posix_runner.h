// ProgramRunner by posix_spawn: no shell, no inherited descriptors, signals, directory or
// environment, a session of its own, and a cgroup of its own where there are cgroups.
//
// One thread watches all running programs (pidfd, pipe, deadline). posix_spawn is used rather than
// fork because it copies no page tables and runs no pthread_atfork handlers. What is spawned is
// rips-exec itself, which becomes the program (enter.h): the very file that was checked.
//
// A run is over when its main process has ended. What it leaves behind is killed then; where there
// are no cgroups, a process that left the session by setsid() escapes.
#ifndef RIPS_MODE_ACTUATOR_HELPERS_EXEC_POSIX_RUNNER_H_
#define RIPS_MODE_ACTUATOR_HELPERS_EXEC_POSIX_RUNNER_H_

#include <sys/types.h>

#include <deque>
#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/program_runner.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"
#include "services/runtime/run_cgroups.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips::actuator {

// From the call until the program itself runs.
inline constexpr absl::Duration kEnterTimeout = absl::Seconds(2);

struct PosixRunnerOptions {
  std::vector<ProgramSpec> allowed;
  std::string robot;  // for RIPS_ROBOT and RIPS_HOST; empty = not set
  std::string host;
  std::string enter = "/proc/self/exe";  // rips-exec
  RunCgroups* cgroups = nullptr;         // not owned, outlives the runner; null = without
};

class PosixRunner final : public ProgramRunner {
 public:
  // `clock` is not owned and outlives this; its boottime must really pass.
  PosixRunner(PosixRunnerOptions options, const Clock* clock);
  // Kills what runs (no grace) and calls the pending `done`s.
  ~PosixRunner() override;

  // Returns when the program itself runs.
  absl::StatusOr<uint64_t> Start(const ProgramRequest& request, Done done) override
      ABSL_LOCKS_EXCLUDED(start_mu_, mu_);
  void Cancel(uint64_t run) override ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Examine(absl::string_view name) override;

 private:
  struct Run;

  absl::StatusOr<const ProgramSpec*> Find(absl::string_view name) const;
  // The checked file.
  absl::StatusOr<UniqueFd> Open(const ProgramSpec& spec) const;
  // ResourceExhausted if a limit would be exceeded now.
  absl::Status CheckLimits(const ProgramSpec& spec) ABSL_EXCLUSIVE_LOCKS_REQUIRED(start_mu_)
      ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Spawn(const ProgramRequest& request, int program_fd, Run& run) const;
  void Loop();
  void PollOnce(int timeout_ms);
  int StepAll(bool stopping);  // milliseconds until the next deadline
  static void Enforce(Run& run, int64_t now_ns);
  // True when its main process has ended: reaped, and what it left behind is killed.
  static bool Reap(Run& run, int64_t now_ns);
  // True when nothing of it is there any more.
  static bool TryReap(Run& run, int64_t now_ns);

  const PosixRunnerOptions options_;
  const Clock* const clock_;
  const WakeFd wake_;
  Mutex start_mu_;  // before mu_; one program starts at a time
  // Starts of the last minute, for programs with such a limit. CLOCK_BOOTTIME.
  std::map<const ProgramSpec*, std::deque<int64_t>> starts_ ABSL_GUARDED_BY(start_mu_);
  Mutex mu_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  uint64_t next_run_ ABSL_GUARDED_BY(mu_) = 1;
  // Each Run's fields belong to the loop thread, except where it says otherwise.
  std::map<uint64_t, std::shared_ptr<Run>> runs_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_HELPERS_EXEC_POSIX_RUNNER_H_
