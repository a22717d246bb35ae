// `ripsctl robot maintenance`: a robot whose agents may be away.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/robot_level.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_reader.h"

namespace rips::ripsctl {
namespace {

class SetMaintenance final : public RobotCommand {
 public:
  SetMaintenance()
      : RobotCommand({"robot", "maintenance",
                      "Announce that a robot's agents may be away; changes no level or decision"}) {
  }
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("--for", for_, "How long from now, 1min to 24h; replaces the end before");
    app.add_flag("--end", end_, "End it now");
    app.add_option("--reason", reason_, "Reason, shown with the robot's alerts")->required();
  }
  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(RobotCommand::Check());
    RIPS_RETURN_IF_ERROR(CheckReason(reason_));
    if (end_ != for_.empty()) {
      return absl::InvalidArgumentError("write either --for DURATION or --end");
    }
    if (end_) return absl::OkStatus();
    const absl::StatusOr<absl::Duration> duration = ParseConfigDuration(for_);
    if (!duration.ok()) {
      return absl::InvalidArgumentError(absl::StrCat("--for: ", duration.status().message()));
    }
    if (*duration < absl::Minutes(1) || *duration > absl::Hours(24)) {
      return absl::InvalidArgumentError(
          absl::StrCat("--for is `", for_, "`; a maintenance takes 1min to 24h"));
    }
    for_ms_ = absl::ToInt64Milliseconds(*duration);
    return absl::OkStatus();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::SetMaintenanceRequest request;
    request.set_robot(robot_);
    request.set_for_ms(static_cast<uint64_t>(for_ms_));
    request.set_reason(reason_);
    RIPS_ASSIGN_OR_RETURN(const auto seen, ReadLevel(env, robot_));
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::SetMaintenance, request));
    const bool holds = response.has_maintenance();
    if (env.json()) {
      return PrintJson(env,
                       {{"robot", robot_},
                        {"maintenance", holds ? ToJson(response.maintenance()) : Json(nullptr)}});
    }
    if (seen.status().has_maintenance()) {
      env.out << "until now: " << EscapeText(MaintenanceText(seen.status())) << "\n";
    }
    if (!holds) {
      env.out << robot_ << " is no longer in maintenance\n";
      for (const std::string& why : seen.status().degraded()) {
        env.out << "still: " << EscapeText(why) << "\n";
      }
      return ExitCode::kDone;
    }
    env.out << robot_ << " is in maintenance until "
            << ShortTime(response.maintenance().until_unix_ns())
            << "; its level, rules and fail-safe work as before\n";
    return ExitCode::kDone;
  }

 private:
  std::string for_;
  bool end_ = false;
  std::string reason_;
  // 0 = it ends now.
  int64_t for_ms_ = 0;
};

}  // namespace

Commands MaintenanceCommands() { return MakeCommands<SetMaintenance>(); }

}  // namespace rips::ripsctl
