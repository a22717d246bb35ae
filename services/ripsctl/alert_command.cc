#include "services/ripsctl/alert_command.h"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "services/ripsctl/json_view.h"
#include "services/ripsctl/printer.h"

namespace rips::ripsctl {
namespace {

class AlertCommand : public Command {
 public:
  absl::string_view noun() const final { return "alert"; }

 protected:
  std::string robot_;
};

class ListAlerts final : public AlertCommand {
 public:
  absl::string_view verb() const override { return "list"; }
  absl::string_view synopsis() const override { return "List alerts, newest first"; }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id; none = all");
    app.add_option("--limit", limit_, "How many, at most")
        ->check(CLI::Range(1, 1000))
        ->capture_default_str();
  }
  ExitCode Run(Env& env) override {
    if (const absl::Status valid = CheckRobot(robot_); !robot_.empty() && !valid.ok()) {
      return UsageError(env, valid.message());
    }
    v1::ListAlertsRequest request;
    request.set_robot(robot_);
    request.set_limit(limit_);
    const auto response = Call(env, &Stub::ListAlerts, request);
    if (!response.ok()) return Failed(env, response.status());
    if (env.json()) {
      Json alerts = Json::array();
      for (const v1::Alert& alert : response->alerts()) alerts.push_back(ToJson(alert));
      PrintJson({{"alerts", std::move(alerts)}}, env.out);
      return ExitCode::kDone;
    }
    Table table({"TIME", "ROBOT", "SEVERITY", "LEVEL", "RULE", "TEXT"});
    for (const v1::Alert& alert : response->alerts()) {
      table.Add({ShortTime(alert.time_unix_ns()), alert.robot(), alert.severity(), alert.level(),
                 alert.rule(), alert.text()});
    }
    table.Print(env.out);
    return ExitCode::kDone;
  }

 private:
  uint32_t limit_ = 100;
};

class WatchAlerts final : public AlertCommand {
 public:
  absl::string_view verb() const override { return "watch"; }
  absl::string_view synopsis() const override { return "Show alerts as they come"; }
  void AddFlags(CLI::App& app) override { app.add_option("ROBOT", robot_, "Robot id; none = all"); }
  ExitCode Run(Env& env) override {
    if (const absl::Status valid = CheckRobot(robot_); !robot_.empty() && !valid.ok()) {
      return UsageError(env, valid.message());
    }
    v1::WatchAlertsRequest request;
    request.set_robot(robot_);
    grpc::ClientContext context;
    const auto reader = env.server->WatchAlerts(&context, request);
    v1::Alert alert;
    while (reader->Read(&alert)) {
      if (env.json()) {
        PrintJson(ToJson(alert), env.out);
        continue;
      }
      env.out << ShortTime(alert.time_unix_ns()) << "  " << EscapeText(alert.robot()) << "  "
              << EscapeText(alert.severity()) << "  " << EscapeText(alert.level()) << "  "
              << EscapeText(alert.rule()) << ": " << EscapeText(alert.text()) << std::endl;
    }
    return Ended(env, reader->Finish());
  }
};

}  // namespace

Commands AlertCommands() {
  Commands commands;
  commands.push_back(std::make_unique<ListAlerts>());
  commands.push_back(std::make_unique<WatchAlerts>());
  return commands;
}

}  // namespace rips::ripsctl
