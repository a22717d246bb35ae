// `ripsctl rules resume`.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

class ResumeRulesCommand final : public RobotCommand {
 public:
  ResumeRulesCommand()
      : RobotCommand({"rules", "resume",
                      "Allow rules to lower soft levels again after they used up their budget"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("--reason", reason_, "Reason, recorded by the server")->required();
  }
  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(RobotCommand::Check());
    return CheckReason(reason_);
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::ResumeRulesRequest request;
    request.set_robot(robot_);
    request.set_reason(reason_);
    RIPS_RETURN_IF_ERROR(Call(env, &Stub::ResumeRules, request).status());
    if (env.json()) return PrintJson(env, {{"robot", robot_}, {"resumed", true}});
    env.out << "rules of " << robot_ << " may lower soft levels again\n";
    return ExitCode::kDone;
  }

 private:
  std::string reason_;
};

}  // namespace

Commands ResumeRules() { return MakeCommands<ResumeRulesCommand>(); }

}  // namespace rips::ripsctl
