// What a command may touch of the world outside.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_ENV_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_ENV_H_

#include <functional>
#include <istream>
#include <string>

#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/settings.h"
#include "policy_server/ripsctl/cli/text_stream.h"
#include "rips/v1/operator.grpc.pb.h"

namespace rips::ripsctl {

// What the process exits with.
enum class ExitCode {
  kDone = 0,
  kRefused = 1,      // the server said no, a check found something, or output was not written
  kUsage = 2,        // wrong flags, settings or certificate files
  kUnreachable = 3,  // no answer from the server
  kIncomplete = 4,   // done, with a recording that is cut, damaged, or lacks a file
};

struct ExitCodeMeaning {
  ExitCode code;
  const char* meaning;
};
inline constexpr ExitCodeMeaning kExitCodes[] = {
    {ExitCode::kDone, "success"},
    {ExitCode::kRefused, "refused, problems found or output not written"},
    {ExitCode::kUsage, "usage error"},
    {ExitCode::kUnreachable, "server unreachable"},
    {ExitCode::kIncomplete, "recording incomplete"},
};

// Text is for people and may change; JSON is a contract to which fields may be added.
// kJunit: only for commands that write it (Command::writes_junit).
enum class Output { kText, kJson, kJunit };

// Descriptors of the operator's terminal, not owned; -1 = there is none.
struct TerminalFds {
  int in = -1;
  int out = -1;
};

struct Env {
  TextStream out;
  TextStream err;
  Output output = Output::kText;
  // For one call; a watch has none.
  absl::Duration timeout = absl::Seconds(10);
  // Not owned; nullptr for commands that need no server.
  v1::OperatorService::StubInterface* server = nullptr;
  // What applies to this command; `context` is the chosen one.
  RawSettings settings;
  // Where the settings file is, or would be; empty without HOME.
  std::string settings_path;
  SettingsFile settings_file;
  // Standard input. Not owned; nullptr is an empty one.
  std::istream* in = nullptr;
  TerminalFds terminal;
  // The descriptor below `out`, not owned; -1: there is none. A watch ends when its reader goes.
  int out_fd = -1;
  // Waits between two questions; a test lets time pass instead.
  std::function<void(absl::Duration)> sleep = absl::SleepFor;

  bool json() const { return output == Output::kJson; }
};

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_ENV_H_
