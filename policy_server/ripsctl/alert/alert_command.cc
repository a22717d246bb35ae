// `ripsctl alert`: list, watch.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/keep_watching.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

// With the event that raised it, which names who it was, or says that the graph was truncated.
std::string TextOf(const v1::Alert& alert) {
  if (alert.event().empty() || alert.event() == "graph change") return alert.text();
  return absl::StrCat(alert.text(), " [", alert.event(), "]");
}

// Of what there are alerts: a robot, or the server itself, as the column ROBOT names it.
constexpr absl::string_view kServer = "(server)";

class AlertCommand : public Command {
 public:
  using Command::Command;
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id, or `(server)`; default: all");
  }
  absl::Status Check() override {
    return robot_.empty() || robot_ == kServer ? absl::OkStatus() : CheckRobot(robot_);
  }

 protected:
  std::string robot_;
};

class ListAlerts final : public AlertCommand {
 public:
  ListAlerts() : AlertCommand({"alert", "list", "List alerts, newest first"}) {}
  void AddFlags(CLI::App& app) override {
    AlertCommand::AddFlags(app);
    app.add_option("--limit", limit_, "Maximum number of entries")
        ->check(CLI::Range(1, 1000))
        ->capture_default_str();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::ListAlertsRequest request;
    request.set_robot(robot_);
    request.set_limit(limit_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ListAlerts, request));
    if (env.json()) {
      return PrintJson(env, {{"alerts", JsonList(response.alerts())},
                             {"cut", response.cut()},
                             {"unrecorded", JsonList(response.unrecorded())}});
    }
    Table table({"TIME", "ROBOT", "SEVERITY", "LEVEL", "RULE", "ID", "TEXT"});
    const auto add = [&table](const v1::Alert& alert) {
      table.Add({ShortTime(alert.time_unix_ns()), alert.robot(), alert.severity(), alert.level(),
                 alert.rule(), ShortId(alert.id()), TextOf(alert)});
    };
    for (auto it = response.unrecorded().rbegin(); it != response.unrecorded().rend(); ++it) {
      add(*it);
    }
    std::for_each(response.alerts().begin(), response.alerts().end(), add);
    if (response.unrecorded_size() > 0) {
      env.out << "the first " << response.unrecorded_size()
              << " are in the server's memory only: its store cannot be written\n";
    }
    table.Print(env.out);
    if (response.cut()) env.out << "older alerts do not fit into one response\n";
    return ExitCode::kDone;
  }

 private:
  uint32_t limit_ = 100;
};

class WatchAlerts final : public AlertCommand {
 public:
  WatchAlerts()
      : AlertCommand({"alert", "watch",
                      "Show new alerts as they arrive, each once, reconnecting when needed"}) {}
  void AddFlags(CLI::App& app) override {
    AlertCommand::AddFlags(app);
    app.add_option("--after", cursor_,
                   "Cursor of an earlier watch to continue from; 0: the oldest stored alert; "
                   "default: the next alert");
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::WatchAlertsRequest request;
    request.set_robot(robot_);
    const auto open = [&](grpc::ClientContext* context) {
      request.set_after(cursor_);
      return env.server->WatchAlerts(context, request);
    };
    RIPS_RETURN_IF_ERROR(Watch<v1::Alert>(env, open, [&](const v1::Alert& alert) {
      if (!alert.cursor().empty()) cursor_ = alert.cursor();
      if (!alert.gap().empty()) {
        env.err << "note: " << EscapeText(alert.gap()) << std::endl;
      } else if (!alert.id().empty()) {
        Print(env, alert);
      }
    }));
    return ExitCode::kDone;
  }

 private:
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

  // Of the newest alert.
  std::string cursor_;
};

}  // namespace

Commands AlertCommands() { return MakeCommands<ListAlerts, WatchAlerts>(); }

}  // namespace rips::ripsctl
