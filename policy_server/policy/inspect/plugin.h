// A plugin: an external program that is asked whether a message is bad.
//
// Two protocols; which one a program speaks is found out by ProbePlugins.
//
// Framed. The process keeps running. It writes `rips-plugin 1\n` when it is ready, then for each
// question reads
//     u32, little endian: size of the header
//     the header, JSON: {"topic":T,"type":T,"sender":N,"writer":HEX,"time_unix_ns":I,
//                        "payload_bytes":P,"size_bytes":S}
//     P bytes: the payload as received; fewer than S if only the beginning was sent
// and answers `1\n` (yes), `0\n` (no) or `?\n` (it cannot tell: unscanned). Anything else, an
// answer nobody asked for, a late answer and an end of the process mean unscanned, and that the
// process is replaced. What it writes to its standard error is ignored, and shown if it fails.
//
// One-shot, as the RIPS prototype: started for each message, the payload on standard input, which
// then ends. Exit status 0 is yes; 1 to 125 is no if it wrote nothing to its standard error, else
// unscanned, for so end programs that crashed: Python and the shells exit with 1 or 2 and say why.
// Other statuses, an end by a signal, no end in time and kPluginOutputBytesMax of output mean
// unscanned. Output is otherwise ignored. If it turns out to greet like a framed one, which was
// only slow when it was probed, it is unscanned and framed from then on.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_PLUGIN_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_PLUGIN_H_

#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/policy/engine/state/verdict.h"
#include "policy_server/policy/inspect/child_process.h"
#include "policy_server/policy/inspect/message.h"
#include "policy_server/policy/inspect/restart_policy.h"
#include "services/base/clock.h"

namespace rips::inspect {

// So much output between two questions, or of a one-shot process in all, is too much.
inline constexpr size_t kPluginOutputBytesMax = 4096;
// A larger payload is unscanned.
inline constexpr size_t kPluginPayloadBytesMax = size_t{4} << 20;
// A larger header (names that no ROS graph has) is unscanned.
inline constexpr size_t kPluginHeaderBytesMax = size_t{16} << 10;

// So many late ends of a one-shot program in a row, and its robots wait as after a failure of a
// framed one: each costs all of `answer_time`.
inline constexpr int kPluginLateMax = 3;

enum class PluginProtocol { kFramed, kOneShot };

struct PluginOptions {
  // One question; for a one-shot program its start included.
  absl::Duration answer_time = absl::Milliseconds(250);
  // From the start of a framed process to its greeting.
  absl::Duration greeting_time = absl::Seconds(1);
  RestartLimits restart;
  ChildLimits process;
  Containment contain;
};

struct PluginSpec {
  std::string id;
  // Absolute.
  std::string path;
  PluginProtocol protocol = PluginProtocol::kOneShot;
  // The directory of its bundle, which it may read; empty: that of `path`.
  std::string root = {};
};

// Starts each program once, all at a time, and sets its protocol: framed if it greets within
// `greeting_time`, else one-shot, which is logged. Takes at most that long. InvalidArgument with
// every program that cannot start: it ended within that time, and by a signal, with a status above
// 125 or after it wrote to its standard error; the first that cannot be executed at all is the only
// one named. Unavailable if there is no process to be had. `clock`'s boottime must really pass.
absl::Status ProbePlugins(std::vector<PluginSpec>& plugins, const PluginOptions& options,
                          const Clock& clock);

// The header of a framed question. Text that is no UTF-8 is replaced by U+FFFD, the rest is ASCII.
std::string PluginHeader(const Message& message);

// One thread only, which is the thread its processes live with (ChildProcess).
class Plugin {
 public:
  // `clock` is not owned and outlives this; its boottime must really pass.
  Plugin(PluginSpec spec, PluginOptions options, const Clock* clock);
  // Kills the process.
  ~Plugin();

  // Starts a framed process, so that it is ready when the first message comes. Does not wait.
  void Warm();
  // Waits until what Warm started has greeted; at most `greeting_time` since.
  void AwaitWarm();
  // Blocks for at most `answer_time`, and what it takes to kill the process, and for a framed one
  // that must be started, because it is new or failed on another robot's message, `greeting_time`.
  // kUnscanned also while a failed process must wait (RestartPolicy), without work. A failure is
  // logged, at most once a minute, without anything of the message but what the program wrote to
  // its standard error.
  engine::Verdict Ask(const Message& message);

  // Time spent since the last call in starting framed processes: the robot whose question waited is
  // not at fault.
  int64_t TakeStartNs() { return std::exchange(start_ns_, 0); }

  // Processes started, and questions that failed (refused ones not counted).
  uint64_t starts() const { return starts_; }
  uint64_t failures() const { return failures_; }
  // The running framed process, or 0.
  pid_t pid() const { return process_ == nullptr ? 0 : process_->pid(); }
  PluginProtocol protocol() const { return spec_.protocol; }

 private:
  engine::Verdict AskFramed(const Message& message);
  engine::Verdict AskOneShot(const Message& message, int64_t deadline_ns);
  // False if it failed, which is then counted and blamed.
  bool StartProcess();
  // False if it failed.
  bool AwaitGreeting();
  // Gives up a process that ended, or spoke, since the last question.
  void DropIfUnfit();
  absl::StatusOr<engine::Verdict> Exchange(const std::string& header, absl::string_view payload,
                                           int64_t deadline_ns);
  absl::StatusOr<engine::Verdict> AwaitExit(ChildProcess& process, absl::string_view payload,
                                            int64_t deadline_ns);
  // The framed process failed on a message of `robot`, and is given up.
  void AnswerFailed(absl::string_view robot, absl::string_view why);
  void StartFailed(absl::string_view why);
  void CountFailure(absl::string_view why);
  int64_t Now() const { return clock_->Now().boottime_ns; }

  PluginSpec spec_;
  const PluginOptions options_;
  const Clock* const clock_;  // Not owned; outlives this.
  RestartPolicy restart_;
  // Framed only; nullptr while none runs.
  std::unique_ptr<ChildProcess> process_;
  int64_t greet_by_ns_ = 0;
  bool greeted_ = false;
  // Whose message it was shown last, to be blamed if it ends afterwards; empty: none since its
  // start.
  std::string last_robot_;
  std::string output_;  // read and not yet understood
  // One-shot only.
  int late_in_a_row_ = 0;
  int64_t start_ns_ = 0;
  uint64_t starts_ = 0;
  uint64_t failures_ = 0;
  int64_t logged_ns_ = 0;  // 0: never
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_PLUGIN_H_
