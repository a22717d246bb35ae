// The socket of rips-exec: which users may run programs, and how it reports results.
#ifndef RIPS_MODE_ACTUATOR_HELPERS_EXEC_EXEC_SERVER_H_
#define RIPS_MODE_ACTUATOR_HELPERS_EXEC_EXEC_SERVER_H_

#include <sys/types.h>

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/status/status.h"
#include "absl/time/time.h"
#include "mode_actuator/decide/level_plan.h"
#include "mode_actuator/steps/port/program_runner.h"
#include "mode_actuator/steps/program/exec_message.h"
#include "services/runtime/mutex.h"
#include "services/runtime/unique_fd.h"
#include "services/runtime/wake_fd.h"

namespace rips::actuator {

// kRunsMax for each of two actuators, and questions.
inline constexpr size_t kExecConnectionsMax = 48;
// For a connection to say what it wants, and to read its answer.
inline constexpr absl::Duration kExecPeerTimeout = absl::Seconds(5);

// A connection starts one program. Who has closed it before its program was begun gets none; who
// closes it later leaves the program running, up to its time.
class ExecServer {
 public:
  struct Options {
    uid_t user = 0;  // served beside root; the kernel says who they are
    absl::Duration peer_timeout = kExecPeerTimeout;
    std::vector<ProgramSpec> allowed;  // for their timeouts, which answers name
  };

  // `runner` is not owned and must end before this: its callbacks come here.
  ExecServer(UniqueFd listener, Options options, ProgramRunner* runner);

  // Serves until Stop.
  void Run() ABSL_LOCKS_EXCLUDED(mu_);
  // Any thread.
  void Stop();

 private:
  struct Connection {
    explicit Connection(UniqueFd fd) : channel(std::move(fd)) {}
    ExecChannel channel;
    uint64_t run = 0;         // of the runner; 0 = none
    bool asked = false;       // it has said what it wants
    bool answered = false;    // everything it will ever get has been sent
    int64_t patience_ns = 0;  // until then it must have asked, or read
  };
  using Connections = std::map<uint64_t, Connection>;

  void Accept();
  // False if the connection is to be closed.
  bool Serve(uint64_t id, Connection& connection);
  bool Handle(uint64_t id, Connection& connection, const std::string& message);
  bool Start(uint64_t id, Connection& connection, const ProgramRequest& request);
  // After which it is killed.
  absl::Duration TimeoutOf(const ProgramRequest& request) const;
  bool Answer(Connection& connection, const ExecAnswer& answer);
  bool Refuse(Connection& connection, const absl::Status& why);
  void ReportEnded() ABSL_LOCKS_EXCLUDED(mu_);
  bool TimedOut(const Connection& connection, int64_t now_ns) const;

  const UniqueFd listener_;
  const WakeFd wake_;
  const Options options_;
  ProgramRunner* const runner_;  // Not owned.
  // Of the thread in Run.
  Connections connections_;
  std::map<uint64_t, std::string> running_;  // by connection, also when that is gone: the program
  uint64_t next_ = 1;

  Mutex mu_;
  bool stopping_ ABSL_GUARDED_BY(mu_) = false;
  std::vector<std::pair<uint64_t, ProgramResult>> ended_ ABSL_GUARDED_BY(mu_);  // by connection
};

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_HELPERS_EXEC_EXEC_SERVER_H_
