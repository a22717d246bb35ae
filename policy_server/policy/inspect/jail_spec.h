// What the policy server tells its two helpers, on the command line and by inherited descriptors.
//
//   rips-inspect plugin UID GID BYTES FILES TASKS READABLE... -- PROGRAM
//   rips-inspect probe  UID GID BYTES FILES TASKS READABLE... --
//   rips-scan    yara   UID GID BYTES FILES TASKS --
//
// UID and GID are `-` to keep those of the caller. READABLE are absolute paths. rips-inspect
// contains a plugin and is linked with the C library only, since it is started for each message of
// a one-shot plugin. rips-scan is the scanner.
#ifndef RIPS_POLICY_SERVER_POLICY_INSPECT_JAIL_SPEC_H_
#define RIPS_POLICY_SERVER_POLICY_INSPECT_JAIL_SPEC_H_

#include <sys/types.h>

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace rips::inspect {

// Descriptors of a helper besides 0, 1 and 2.
//
// On kReportFd it writes lines that begin with one of the characters below, and closes it when the
// program runs. kReportExec comes from the caller's side of the exec, with a 4-byte errno.
inline constexpr int kReportFd = 3;
// The cgroup.procs that it enters, or /dev/null.
inline constexpr int kCgroupFd = 4;
// rips-scan only: a RuleImage and the payload's memory.
inline constexpr int kRulesFd = 5;
inline constexpr int kPayloadFd = 6;

inline constexpr char kReportExec = 'E';
inline constexpr char kReportMissing = '-';  // what cannot be enforced here
inline constexpr char kReportSweeps = 's';   // no PID namespace: end it by SIGTERM, then it sweeps
inline constexpr char kReportFailed = '!';   // why the program does not run

struct JailIds {
  uid_t uid = 0;
  gid_t gid = 0;
};

struct JailSpec {
  std::string mode;
  // Only root can give others.
  std::optional<JailIds> ids;
  // Limits (setrlimit); 0: none.
  uint64_t address_space_bytes = 0;
  uint64_t open_files = 0;
  // Processes and threads.
  uint64_t tasks = 0;
  // Files, or directories with all below: may be read and executed. What is not there is left out.
  std::vector<std::string> readable;
  std::string program;
};

// Reads a command line; false if it is none of ours.
bool ParseJailSpec(const std::vector<std::string>& words, JailSpec* spec);
// Enters the cgroup and keeps kReportFd from programs. Ends the process if it was not started as
// above, with a line for people.
void BeginJail(int argc, char** argv, JailSpec* spec);

// One payload's question to a scanner, on its standard input; host byte order. The payload is at
// the beginning of kPayloadFd. The answer is `1`, `0` or `?` on standard output.
struct ScanQuestion {
  uint32_t rules = 0;
  uint32_t bytes = 0;
  int64_t timeout_ns = 0;
};

// The content of kRulesFd: this, `count` sizes (uint64_t), then as many compiled files.
struct RuleImageHeader {
  uint64_t count = 0;
};

}  // namespace rips::inspect

#endif  // RIPS_POLICY_SERVER_POLICY_INSPECT_JAIL_SPEC_H_
