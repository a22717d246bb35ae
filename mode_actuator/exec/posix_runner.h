// ProgramRunner by posix_spawn: no shell, no inherited descriptors, signals, directory or
// environment, a session of its own.
//
// One thread watches all running programs (pidfd, pipe, deadline). posix_spawn is used rather than
// fork because it copies no page tables and runs no pthread_atfork handlers, of which gRPC has
// several. A program that leaves its session by setsid() escapes the kill; its output is cut off.
#ifndef RIPS_MODE_ACTUATOR_EXEC_POSIX_RUNNER_H_
#define RIPS_MODE_ACTUATOR_EXEC_POSIX_RUNNER_H_

#include <sys/types.h>

#include <map>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "mode_actuator/level_plan.h"
#include "mode_actuator/program_runner.h"
#include "services/base/clock.h"
#include "services/runtime/mutex.h"

namespace rips::actuator {

// OK if nobody but root can change what `path` names: absolute, no `.` or `..`, every directory and
// the file itself owned by root, not writable by group or others, no symbolic link anywhere; the
// file regular and executable. `root_fd` is the directory that stands for `/`. NotFound or
// PermissionDenied, naming the component.
absl::Status CheckProgramPath(int root_fd, absl::string_view path);

class PosixRunner final : public ProgramRunner {
 public:
  // `clock` is not owned and outlives this; its boottime must really pass.
  static absl::StatusOr<std::unique_ptr<PosixRunner>> Create(std::vector<ProgramSpec> allowed,
                                                             const Clock* clock);
  // Kills what runs (no grace) and calls the pending `done`s.
  ~PosixRunner() override;

  absl::StatusOr<uint64_t> Start(const ProgramRequest& request, Done done) override
      ABSL_LOCKS_EXCLUDED(mu_);
  void Cancel(uint64_t run) override ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Examine(absl::string_view name) override;

 private:
  struct Run;

  PosixRunner(std::vector<ProgramSpec> allowed, const Clock* clock, int wake_fd);

  absl::StatusOr<const ProgramSpec*> Find(absl::string_view name) const;
  absl::StatusOr<const ProgramSpec*> Admit(const ProgramRequest& request) const;
  void Loop();
  void PollOnce(int timeout_ms);
  int StepAll(bool stopping);  // milliseconds until the next deadline
  void Enforce(Run& run, int64_t now_ns);
  // True when it is over and reaped.
  bool TryReap(Run& run, int64_t now_ns);
  void Wake() const;

  const std::vector<ProgramSpec> allowed_;
  const Clock* const clock_;
  const int wake_fd_;
  Mutex mu_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  uint64_t next_run_ ABSL_GUARDED_BY(mu_) = 1;
  // Each Run's fields belong to the loop thread, except where it says otherwise.
  std::map<uint64_t, std::shared_ptr<Run>> runs_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_EXEC_POSIX_RUNNER_H_
