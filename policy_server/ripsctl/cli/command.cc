#include "policy_server/ripsctl/cli/command.h"

#include <CLI/CLI.hpp>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "services/base/ids.h"
#include "services/rpc/handshake_hint.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
namespace {

constexpr size_t kReasonBytesMax = 1'000;

}  // namespace

ExitCode UsageError(Env& env, absl::string_view message) {
  env.err << "error: " << EscapeText(message) << "\n";
  return ExitCode::kUsage;
}

ExitCode Failed(Env& env, const absl::Status& status) {
  const std::string message = EscapeText(status.message());
  switch (status.code()) {
    case absl::StatusCode::kUnavailable: {
      // The server's own words.
      if (absl::EndsWith(status.message(), "; try again later")) {
        env.err << "error: " << message << "\n";
        return ExitCode::kRefused;
      }
      const std::string hint = EscapeText(rpc::HandshakeHint(
          status.message(), env.settings.server,
          {.ca = env.settings.ca, .cert = env.settings.cert, .key = env.settings.key, .crl = {}}));
      env.err << "error: cannot reach the policy server: "
              << (hint.empty() ? "" : absl::StrCat(hint, ": ")) << message
              << "; check --server, that the server runs, and that it accepts your certificate\n";
      return ExitCode::kUnreachable;
    }
    case absl::StatusCode::kDeadlineExceeded:
      env.err << "error: no answer from the policy server within "
              << absl::FormatDuration(env.timeout) << "; check --server, or give it a longer "
              << "--timeout\n";
      return ExitCode::kUnreachable;
    case absl::StatusCode::kPermissionDenied:
      env.err << "error: refused: " << message << "\n";
      return ExitCode::kRefused;
    case absl::StatusCode::kUnimplemented:
      env.err << "error: the policy server does not know this call; is it older than this ripsctl?"
              << (message.empty() ? "" : absl::StrCat(" (", message, ")")) << "\n";
      return ExitCode::kRefused;
    default:
      env.err << "error: " << message << "\n";
      return ExitCode::kRefused;
  }
}

absl::Status FileError(const absl::Status& status) {
  return status.ok() ? status : absl::InternalError(status.message());
}

void RobotCommand::AddFlags(CLI::App& app) {
  app.add_option("ROBOT", robot_, "Robot id")->required();
}

absl::Status RobotCommand::Check() { return CheckRobot(robot_); }

absl::Status CheckRobot(absl::string_view robot) { return ValidateName("robot id", robot); }

absl::Status CheckReason(absl::string_view reason) {
  if (absl::StripAsciiWhitespace(reason).empty()) {
    return absl::InvalidArgumentError(
        "--reason is empty; give a reason, which is recorded with the decision");
  }
  if (reason.size() > kReasonBytesMax) {
    return absl::InvalidArgumentError(
        absl::StrCat("--reason has ", reason.size(), " bytes, limit ", kReasonBytesMax));
  }
  if (FindInvalidUtf8(reason)) return absl::InvalidArgumentError("--reason is not valid UTF-8");
  return absl::OkStatus();
}

}  // namespace rips::ripsctl
