// One `ripsctl NOUN VERB`.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_CLI_COMMAND_H_
#define RIPS_POLICY_SERVER_RIPSCTL_CLI_COMMAND_H_

#include <memory>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "absl/time/clock.h"
#include "policy_server/ripsctl/cli/env.h"
#include "services/rpc/status_conversion.h"

namespace CLI {
class App;
}

namespace rips::ripsctl {

class Command {
 public:
  virtual ~Command() = default;
  virtual absl::string_view noun() const = 0;
  // Empty: the noun alone is the command.
  virtual absl::string_view verb() const = 0;
  // One line for --help.
  virtual absl::string_view synopsis() const = 0;
  virtual bool needs_server() const { return true; }
  // Knows `--output junit` too.
  virtual bool writes_junit() const { return false; }
  // Declares arguments and flags, kept in members. Called once, before Run.
  virtual void AddFlags(CLI::App& app) = 0;
  // Prints the result to env.out and errors to env.err.
  virtual ExitCode Run(Env& env) = 0;
};

using Commands = std::vector<std::unique_ptr<Command>>;

// `error: ...` on env.err, hostile characters escaped.
ExitCode UsageError(Env& env, absl::string_view message);
// The same for what a call came to: kUnreachable if there was no answer, else kRefused.
ExitCode Failed(Env& env, const absl::Status& status);
// As Failed for a watch: kDone if it ended well.
ExitCode Ended(Env& env, const grpc::Status& status);

// OK for a name that could be a robot's.
absl::Status CheckRobot(absl::string_view robot);
// OK for 1 to 1,000 bytes of UTF-8 with something in them.
absl::Status CheckReason(absl::string_view reason);

// One call with env's timeout, for example Call(env, &Stub::GetLevel, request).
template <typename Request, typename Response>
absl::StatusOr<Response> Call(Env& env,
                              grpc::Status (v1::OperatorService::StubInterface::*method)(
                                  grpc::ClientContext*, const Request&, Response*),
                              const Request& request) {
  grpc::ClientContext context;
  context.set_deadline(absl::ToChronoTime(absl::Now() + env.timeout));
  Response response;
  const grpc::Status status = (env.server->*method)(&context, request, &response);
  if (!status.ok()) return rpc::FromGrpc(status);
  return response;
}

using Stub = v1::OperatorService::StubInterface;

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_CLI_COMMAND_H_
