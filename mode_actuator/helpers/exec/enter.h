// The first thing a run does, in its own process: it enters its cgroup and becomes the program.
//
// rips-exec starts itself (posix_spawn, so nothing is forked) as `rips-exec --enter ARGV0 ARG...`
// with
//   kEnterProgramFd  the program's file, open for reading
//   kEnterCgroupFd   the cgroup.procs of the run's cgroup, or /dev/null, open for writing
//   kEnterReportFd   a pipe: kEnterReady is written there and then, if it cannot be executed, why;
//                    closed by the exec. No kEnterReady: it did not come that far
// and the environment and the standard descriptors that the program is to have. No core is dumped.
//
// A program that begins with `#!` is opened by its interpreter, by the name /dev/fd/3: so it keeps
// kEnterProgramFd and is called that. Any other has the standard descriptors only.
#ifndef RIPS_MODE_ACTUATOR_HELPERS_EXEC_ENTER_H_
#define RIPS_MODE_ACTUATOR_HELPERS_EXEC_ENTER_H_

namespace rips::actuator {

inline constexpr char kEnterFlag[] = "--enter";
inline constexpr int kEnterProgramFd = 3;
inline constexpr int kEnterCgroupFd = 4;
inline constexpr int kEnterReportFd = 5;
inline constexpr char kEnterReady = '+';

// True if main was called to do this.
bool IsEnter(int argc, char* const* argv);
// Does not return unless it failed: the exit code.
int EnterAndExec(int argc, char** argv);

}  // namespace rips::actuator

#endif  // RIPS_MODE_ACTUATOR_HELPERS_EXEC_ENTER_H_
