// ProgramRunner by asking rips-exec.
#ifndef RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_CLIENT_H_
#define RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_CLIENT_H_

#include <sys/types.h>

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "absl/base/thread_annotations.h"
#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "mode_actuator/steps/port/program_runner.h"
#include "mode_actuator/steps/program/exec_message.h"
#include "services/local_socket/helper_door.h"
#include "services/runtime/mutex.h"
#include "services/runtime/wake_fd.h"

namespace rips::actuator {

// What is waited for rips-exec to say that a program was begun, or whether it could be.
inline constexpr absl::Duration kExecAnswerTimeout = absl::Seconds(5);
// After a program's time, for rips-exec to kill it and to say so.
inline constexpr absl::Duration kExecEndSlack = absl::Seconds(5);

// A connection for each run: rips-exec may be started by it, or anew between two.
//
// | rips-exec                                | the result                                       |
// |------------------------------------------|--------------------------------------------------|
// | is not there                             | Unavailable, at once                             |
// | is another process that poses as it      | PermissionDenied, at once; nothing was asked     |
// | refuses                                  | as ProgramRunner::Start says, not begun          |
// | ends before it has read what we ask      | Unavailable, not begun                           |
// | ends, or says nothing in time, before it | Unknown                                          |
// | answered that the program was begun      |                                                  |
// | ends while it runs                       | Unknown: `rips-exec ended while it ran`          |
// | does not report the end in time          | Unknown                                          |
class ExecClient final : public ProgramRunner {
 public:
  struct Options {
    std::string socket;
    // The user that rips-exec runs as, if there is one.
    std::optional<uid_t> run_as = std::nullopt;
    absl::Duration answer_timeout = kExecAnswerTimeout;
    absl::Duration end_slack = kExecEndSlack;
  };

  explicit ExecClient(const Options& options);
  // Has what runs killed, without waiting for it, and calls the pending `done`s.
  ~ExecClient() override;

  absl::StatusOr<uint64_t> Start(const ProgramRequest& request, Done done) override
      ABSL_LOCKS_EXCLUDED(mu_);
  void Cancel(uint64_t run) override ABSL_LOCKS_EXCLUDED(mu_);
  absl::Status Examine(absl::string_view name) override;
  // As HelperDoor::Check.
  absl::Status CheckSocket() const { return door_.Check(); }

 private:
  struct Call;

  absl::StatusOr<std::shared_ptr<Call>> Ask(const ExecCall& call) const;
  void Loop() ABSL_LOCKS_EXCLUDED(mu_);
  // Milliseconds until the next deadline.
  int StepAll() ABSL_LOCKS_EXCLUDED(mu_);
  // True when it is over: then its result holds.
  bool Step(Call& call, int64_t now_ns) const;
  // True when there was a message, which may have ended it.
  bool AcceptAnswer(Call& call) const;
  void Poll(int timeout_ms) ABSL_LOCKS_EXCLUDED(mu_);

  const Options options_;
  const HelperDoor door_;
  const WakeFd wake_;
  Mutex mu_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  uint64_t next_ ABSL_GUARDED_BY(mu_) = 1;
  // Each Call's fields belong to the thread, except where it says otherwise.
  std::map<uint64_t, std::shared_ptr<Call>> calls_ ABSL_GUARDED_BY(mu_);
  std::thread thread_;
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_STEPS_PROGRAM_EXEC_CLIENT_H_
