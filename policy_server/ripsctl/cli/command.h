// One `ripsctl NOUN VERB`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_COMMAND_H_

#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/match.h"
#include "absl/strings/string_view.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/env.h"
#include "services/rpc/status_conversion.h"

namespace CLI {
class App;
}

namespace rips::ripsctl {

// What a command uses of the settings.
enum class SettingsUse {
  kAll,      // a context that is not in the settings file is an error
  kFile,     // the settings file, whichever context is chosen
  kNothing,  // flags only: works with a settings file that is wrong
};

class Command {
 public:
  struct Info {
    std::string noun;
    std::string verb;      // empty: the noun alone is the command
    std::string synopsis;  // one line for --help
    bool needs_server = true;
    bool writes_junit = false;  // knows `--output junit`, too
    SettingsUse uses = SettingsUse::kAll;
  };

  explicit Command(Info info) : info_(std::move(info)) {}
  virtual ~Command() = default;

  const Info& info() const { return info_; }
  // Declares arguments and flags, kept in members. Called once, first.
  virtual void AddFlags(CLI::App&) {}
  // InvalidArgument, or another error, if the arguments make no sense. Called before Run.
  virtual absl::Status Check() { return absl::OkStatus(); }
  // Prints the result to env.out. An error is printed by the caller, as Failed does.
  virtual absl::StatusOr<ExitCode> Run(Env& env) = 0;

 private:
  const Info info_;
};

using Commands = std::vector<std::unique_ptr<Command>>;

template <typename... Each>
Commands MakeCommands() {
  Commands commands;
  (commands.push_back(std::make_unique<Each>()), ...);
  return commands;
}

// A command whose first argument is the id of a robot.
class RobotCommand : public Command {
 public:
  using Command::Command;
  void AddFlags(CLI::App& app) override;
  absl::Status Check() override;

 protected:
  std::string robot_;
};

// `error: ...` on env.err, hostile characters escaped.
ExitCode UsageError(Env& env, absl::string_view message);
// The same for what a call came to: kUnreachable if there was no answer, else kRefused.
ExitCode Failed(Env& env, const absl::Status& status);

// `status` of a file that this process writes or reads, such as a full disk: printed as it is, and
// not taken for the server's (kRefused).
absl::Status FileError(const absl::Status& status);

// OK for a name that could be a robot's.
absl::Status CheckRobot(absl::string_view robot);
// OK for 1 to 1,000 bytes of UTF-8 with something in them.
absl::Status CheckReason(absl::string_view reason);

// A call that is refused as one too many is made again after this, as long as env's timeout goes.
inline constexpr absl::Duration kCallAgain = absl::Milliseconds(250);

// One call with env's timeout, for example Call(env, &Stub::GetLevel, request).
template <typename Request, typename Response>
absl::StatusOr<Response> Call(Env& env,
                              grpc::Status (v1::OperatorService::StubInterface::*method)(
                                  grpc::ClientContext*, const Request&, Response*),
                              const Request& request) {
  const absl::Time end = absl::Now() + env.timeout;
  while (true) {
    grpc::ClientContext context;
    context.set_deadline(absl::ToChronoTime(end));
    Response response;
    const grpc::Status status = (env.server->*method)(&context, request, &response);
    if (status.ok()) return response;
    const bool again = status.error_code() == grpc::StatusCode::RESOURCE_EXHAUSTED &&
                       absl::StartsWith(status.error_message(), rpc::kCalledTooOften) &&
                       absl::Now() + kCallAgain < end;
    if (!again) return rpc::FromGrpc(status);
    absl::SleepFor(kCallAgain);
  }
}

using Stub = v1::OperatorService::StubInterface;

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_COMMAND_H_
