// The command line of ripsctl: finds the command, connects, runs it.
#ifndef RIPS_POLICY_SERVER_RIPSCTL_APP_H_
#define RIPS_POLICY_SERVER_RIPSCTL_APP_H_

#include <functional>
#include <istream>
#include <memory>
#include <ostream>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/env.h"
#include "policy_server/ripsctl/cli/settings.h"
#include "rips/v1/operator.grpc.pb.h"

namespace rips::ripsctl {

// The world, as tests replace it.
struct World {
  std::ostream& out;
  std::ostream& err;
  GetEnv get_env;
  // A stub for the server of the settings; an error means that the settings are wrong. It does not
  // wait for a connection.
  std::function<absl::StatusOr<std::unique_ptr<v1::OperatorService::StubInterface>>(
      const RawSettings&)>
      connect;
  // Standard input; nullptr is an empty one.
  std::istream* in = nullptr;
  // As Env's.
  std::function<void(absl::Duration)> sleep = absl::SleepFor;
  TerminalFds terminal = {};
  int out_fd = -1;
};

// Mutual TLS to `server` with the files of the settings.
absl::StatusOr<std::unique_ptr<v1::OperatorService::StubInterface>> ConnectWithTls(
    const RawSettings& settings);

// `args` without the program's name. Gives the exit code of the process (ExitCode).
int RunRipsctl(const std::vector<std::string>& args, const World& world);

}  // namespace rips::ripsctl

#endif  // RIPS_POLICY_SERVER_RIPSCTL_APP_H_
