#include "policy_server/ripsctl/alert/alert_command.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/keep_watching.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/server_expiry.h"

namespace rips::ripsctl {
namespace {

// With the event that raised it, which names who it was, or says that the graph was truncated.
std::string TextOf(const v1::Alert& alert) {
  if (alert.event().empty() || alert.event() == "graph change") return alert.text();
  return absl::StrCat(alert.text(), " [", alert.event(), "]");
}

// Of what there are alerts: a robot, or the server itself, as the column ROBOT names it.
constexpr absl::string_view kServer = "(server)";
constexpr char kSourceHelp[] = "Robot id, or `(server)`; none = all";

class AlertCommand : public Command {
 public:
  absl::string_view noun() const final { return "alert"; }

 protected:
  absl::Status CheckSource() const {
    return robot_.empty() || robot_ == kServer ? absl::OkStatus() : CheckRobot(robot_);
  }

  std::string robot_;
};

class ListAlerts final : public AlertCommand {
 public:
  absl::string_view verb() const override { return "list"; }
  absl::string_view synopsis() const override { return "List alerts, newest first"; }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, kSourceHelp);
    app.add_option("--limit", limit_, "Maximum number of entries")
        ->check(CLI::Range(1, 1000))
        ->capture_default_str();
  }
  ExitCode Run(Env& env) override {
    if (const absl::Status valid = CheckSource(); !valid.ok()) {
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
      Json unrecorded = Json::array();
      for (const v1::Alert& alert : response->unrecorded()) unrecorded.push_back(ToJson(alert));
      PrintJson({{"alerts", std::move(alerts)},
                 {"cut", response->cut()},
                 {"unrecorded", std::move(unrecorded)}},
                env.out);
      return ExitCode::kDone;
    }
    Table table({"TIME", "ROBOT", "SEVERITY", "LEVEL", "RULE", "ID", "TEXT"});
    const auto add = [&table](const v1::Alert& alert) {
      table.Add({ShortTime(alert.time_unix_ns()), alert.robot(), alert.severity(), alert.level(),
                 alert.rule(), ShortId(alert.id()), TextOf(alert)});
    };
    for (auto it = response->unrecorded().rbegin(); it != response->unrecorded().rend(); ++it) {
      add(*it);
    }
    std::for_each(response->alerts().begin(), response->alerts().end(), add);
    table.Print(env.out);
    if (response->unrecorded_size() > 0) {
      env.out << "the first " << response->unrecorded_size()
              << " are in the server's memory only: its store cannot be written\n";
    }
    if (response->cut()) env.out << "older alerts do not fit into one answer\n";
    return ExitCode::kDone;
  }

 private:
  uint32_t limit_ = 100;
};

class WatchAlerts final : public AlertCommand {
 public:
  absl::string_view verb() const override { return "watch"; }
  absl::string_view synopsis() const override {
    return "Show new alerts as they arrive, each once, reconnecting when needed";
  }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, kSourceHelp);
    app.add_option(
        "--after", cursor_,
        "Begin after this cursor of an earlier watch; 0 = with the oldest that is stored; "
        "none = with the next");
  }
  ExitCode Run(Env& env) override {
    if (const absl::Status valid = CheckSource(); !valid.ok()) {
      return UsageError(env, valid.message());
    }
    return KeepWatching(env, [&](bool again, const std::function<void()>& heard) {
      return WatchOnce(env, again, heard);
    });
  }

 private:
  // One stream, from the newest cursor.
  grpc::Status WatchOnce(Env& env, bool again, const std::function<void()>& heard) {
    v1::WatchAlertsRequest request;
    request.set_robot(robot_);
    request.set_after(cursor_);
    grpc::ClientContext context;
    context.set_wait_for_ready(again);
    const auto reader = env.server->WatchAlerts(&context, request);
    ServerExpiry expiry(&context);
    v1::Alert alert;
    while (reader->Read(&alert)) {
      heard();
      expiry.Received();
      if (!alert.cursor().empty()) cursor_ = alert.cursor();
      if (!alert.gap().empty()) {
        env.err << "note: " << EscapeText(alert.gap()) << std::endl;
      } else if (!alert.id().empty()) {
        Print(env, alert);
      }
    }
    return expiry.End(reader->Finish());
  }

  static void Print(Env& env, const v1::Alert& alert) {
    if (env.json()) {
      Json line = ToJson(alert);
      if (!alert.cursor().empty()) line["cursor"] = alert.cursor();
      return PrintJson(line, env.out);
    }
    env.out << ShortTime(alert.time_unix_ns()) << "  " << EscapeText(alert.robot()) << "  "
            << EscapeText(alert.severity()) << "  " << EscapeText(alert.level()) << "  "
            << EscapeText(alert.rule()) << ": " << EscapeText(TextOf(alert)) << std::endl;
  }

  std::string cursor_;
};

}  // namespace

Commands AlertCommands() {
  Commands commands;
  commands.push_back(std::make_unique<ListAlerts>());
  commands.push_back(std::make_unique<WatchAlerts>());
  return commands;
}

}  // namespace rips::ripsctl
