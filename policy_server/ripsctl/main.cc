// ripsctl: the operator's command line.
#include <stdlib.h>
#include <unistd.h>

#include <cstdlib>
#include <iostream>
#include <optional>
#include <string>
#include <vector>

#include "policy_server/ripsctl/app.h"
#include "services/rpc/credentials.h"
#include "services/runtime/daemon_log.h"
#include "services/runtime/output_stream.h"

int main(int argc, char** argv) {
  rips::OpenStandardStreams();
  rips::HandleSigpipe();
  rips::rpc::RequireTls13();
  // gRPC logs to stderr what the operator is told anyway; the environment may ask for it.
  setenv("GRPC_VERBOSITY", "NONE", /*overwrite=*/0);
  rips::OutputStream out(STDOUT_FILENO);
  std::cerr.tie(&out);  // what is printed first is seen first
  const rips::ripsctl::World world = {
      .out = out,
      .err = std::cerr,
      .get_env = [](const std::string& name) -> std::optional<std::string> {
        const char* value = std::getenv(name.c_str());
        if (value == nullptr) return std::nullopt;
        return value;
      },
      .connect = rips::ripsctl::ConnectWithTls,
      .in = &std::cin,
      .terminal = {.in = isatty(STDIN_FILENO) == 1 ? STDIN_FILENO : -1,
                   .out = isatty(STDOUT_FILENO) == 1 ? STDOUT_FILENO : -1},
      .out_fd = STDOUT_FILENO,
  };
  const std::vector<std::string> args(argv + 1, argv + argc);
  const int code = out.End(rips::ripsctl::RunRipsctl(args, world));
  std::cerr.tie(nullptr);
  return code;
}
