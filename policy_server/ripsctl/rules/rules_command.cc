#include "policy_server/ripsctl/rules/rules_command.h"

#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/rules/rules_builtins.h"
#include "policy_server/ripsctl/rules/rules_check.h"
#include "policy_server/ripsctl/rules/rules_fmt.h"
#include "policy_server/ripsctl/rules/rules_replay.h"
#include "policy_server/ripsctl/rules/rules_test_command.h"

namespace rips::ripsctl {
namespace {

class ResumeRules final : public Command {
 public:
  absl::string_view noun() const override { return "rules"; }
  absl::string_view verb() const override { return "resume"; }
  absl::string_view synopsis() const override {
    return "Allow rules to lower soft levels again after they used up their budget";
  }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id")->required();
    app.add_option("--reason", reason_, "Reason, recorded by the server")->required();
  }
  ExitCode Run(Env& env) override {
    absl::Status valid = CheckRobot(robot_);
    if (valid.ok()) valid = CheckReason(reason_);
    if (!valid.ok()) return UsageError(env, valid.message());
    v1::ResumeRulesRequest request;
    request.set_robot(robot_);
    request.set_reason(reason_);
    const auto response = Call(env, &Stub::ResumeRules, request);
    if (!response.ok()) return Failed(env, response.status());
    if (env.json()) {
      PrintJson({{"robot", robot_}, {"resumed", true}}, env.out);
    } else {
      env.out << "rules of " << robot_ << " may lower soft levels again\n";
    }
    return ExitCode::kDone;
  }

 private:
  std::string robot_;
  std::string reason_;
};

}  // namespace

Commands RulesCommands() {
  Commands commands;
  commands.push_back(CheckRules());
  commands.push_back(FmtRules());
  commands.push_back(RulesBuiltins());
  commands.push_back(TestRules());
  commands.push_back(ReplayRules());
  commands.push_back(std::make_unique<ResumeRules>());
  return commands;
}

}  // namespace rips::ripsctl
