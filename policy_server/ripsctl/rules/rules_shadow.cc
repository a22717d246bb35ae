// `ripsctl rules shadow`: a bundle that runs muted beside the one in force, to see what it would
// do. JSON: {"bundle": as given, or null for --end,"changed":[..],"left_out":[..],
// "notes":[..]}.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/rules/robot_selection_flags.h"
#include "policy_server/ripsctl/rules/rollout_text.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

class ShadowRulesCommand final : public Command {
 public:
  ShadowRulesCommand()
      : Command({"rules", "shadow",
                 "Run a bundle muted beside the one in force, to see what it would do"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("BUNDLE", bundle_,
                   "Id or its first 8 or more digits, as `rules list` shows them");
    app.add_flag("--end", end_, "End the shadows of these robots");
    robots_.AddFlags(app, "All robots whose policy has the bundle's name; with --end, all robots");
    app.add_option("--reason", reason_, "Reason, recorded by the server")->required();
  }
  absl::Status Check() override {
    if (bundle_.empty() != end_) {
      return absl::InvalidArgumentError(
          "give either a BUNDLE, whose shadow is to begin, or --end, to end shadows");
    }
    if (!end_) RIPS_RETURN_IF_ERROR(CheckBundleId(bundle_));
    RIPS_RETURN_IF_ERROR(robots_.Check());
    return CheckReason(reason_);
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::ShadowBundleRequest request;
    request.set_bundle_id(bundle_);
    *request.mutable_robots() = robots_.ToProto();
    request.set_reason(reason_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ShadowBundle, request));
    if (env.json()) {
      PrintJson({{"bundle", end_ ? Json(nullptr) : Json(bundle_)},
                 {"changed", JsonList(response.changed())},
                 {"left_out", JsonList(response.left_out())},
                 {"notes", JsonList(response.notes())}},
                env.out);
    } else {
      Print(env, response);
    }
    // A shadow that is to end and is not there has ended.
    return end_ || !response.changed().empty() ? ExitCode::kDone : ExitCode::kRefused;
  }

 private:
  void Print(Env& env, const v1::ShadowBundleResponse& response) const {
    if (response.changed().empty()) {
      env.out << "nothing changes\n";
    } else {
      env.out << (end_ ? "no shadow any more: " : "runs muted on: ")
              << EscapeText(NamedRobots(response.changed())) << "\n";
    }
    for (const std::string& text : response.left_out()) {
      env.out << "left out  " << EscapeText(text) << "\n";
    }
    for (const std::string& text : response.notes()) {
      env.out << "note      " << EscapeText(text) << "\n";
    }
    if (end_ || response.changed().empty()) return;
    env.out << "what it would do  ripsctl rules status " << ShellWord(response.changed(0)) << "\n"
            << "end it            ripsctl rules shadow --end " << robots_.ToFlags()
            << " --reason TEXT\n";
  }

  std::string bundle_;
  bool end_ = false;
  RobotSelectionFlags robots_;
  std::string reason_;
};

}  // namespace

Commands ShadowRules() { return MakeCommands<ShadowRulesCommand>(); }

}  // namespace rips::ripsctl
