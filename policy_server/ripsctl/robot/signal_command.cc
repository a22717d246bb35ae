// `ripsctl signal send`.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"
#include "services/text/escape.h"

namespace rips::ripsctl {
namespace {

class SendSignalCommand final : public RobotCommand {
 public:
  SendSignalCommand()
      : RobotCommand({"signal", "send", "Send a signal for a robot's rules to judge"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("SIGNAL", signal_, "SIGUSR1 or SIGUSR2")->required();
    app.add_option("--reason", reason_, "Reason, recorded by the server")->required();
  }
  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(RobotCommand::Check());
    std::string name = absl::AsciiStrToUpper(signal_);
    if (!absl::StartsWith(name, "SIG")) name = absl::StrCat("SIG", name);
    if (name != "SIGUSR1" && name != "SIGUSR2") {
      return absl::InvalidArgumentError(
          absl::StrCat("`", signal_, "` is neither SIGUSR1 nor SIGUSR2"));
    }
    signal_ = std::move(name);
    return CheckReason(reason_);
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::SendSignalRequest request;
    request.set_robot(robot_);
    request.set_signal(signal_);
    request.set_reason(reason_);
    RIPS_ASSIGN_OR_RETURN(const v1::SendSignalResponse answer,
                          Call(env, &Stub::SendSignal, request));
    if (env.json()) {
      return PrintJson(env, {{"robot", robot_},
                             {"signal", signal_},
                             {"level_before", answer.level_before()},
                             {"decided_level", answer.decided_level()}});
    }
    env.out << "the rules of " << robot_ << " judged " << signal_ << "; its level";
    if (answer.decided_level() == answer.level_before()) {
      env.out << " is " << EscapeText(answer.decided_level()) << ", as before\n";
    } else {
      env.out << ": " << EscapeText(answer.decided_level())
              << ", before: " << EscapeText(answer.level_before()) << "\n";
    }
    return ExitCode::kDone;
  }

 private:
  std::string signal_;
  std::string reason_;
};

}  // namespace

Commands SignalCommands() { return MakeCommands<SendSignalCommand>(); }

}  // namespace rips::ripsctl
