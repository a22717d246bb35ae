// `ripsctl alert`: list, watch, ack.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <iterator>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/keep_watching.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/cut_text.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_reader.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
namespace {

// With the event that raised it, which names who it was, or says that the graph was truncated; and
// with the maintenance that the robot was in.
std::string TextOf(const v1::Alert& alert) {
  std::string text = alert.text();
  if (!alert.event().empty() && alert.event() != "graph change") {
    absl::StrAppend(&text, " [", alert.event(), "]");
  }
  if (!absl::StrContains(text, alert.maintenance())) {
    absl::StrAppend(&text, " [", alert.maintenance(), "]");
  }
  return text;
}

// Of a cell; who and note are whole in JSON and `ripsctl explain`.
constexpr size_t kAckCellBytes = 48;
constexpr size_t kIdsMax = 100;
constexpr size_t kAlertIdDigitsMin = 6;
constexpr size_t kAlertIdDigitsMax = 32;
constexpr size_t kNoteBytesMax = 1'000;

// `alice: on it`; empty of an alert that is not acknowledged.
std::string AckCell(const v1::Acknowledgement& ack) {
  absl::string_view name = ack.by();
  name = name.substr(0, name.find(' '));
  name = name.substr(name.rfind('/') + 1);
  return Shortened(ack.note().empty() ? name : absl::StrCat(name, ": ", ack.note()), kAckCellBytes);
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
    app.add_flag("--open", open_, "Only alerts that are not acknowledged");
    app.add_option("--severity", severity_,
                   "Only of this severity or a graver one: info, low, medium, high or critical");
    app.add_option("--rule", rule_, "Only of this rule; `(rips)`: RIPS's own alerts");
    app.add_option("--since", since_,
                   "Only those not older than this, for example 30min, 2h or 1d");
  }
  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(AlertCommand::Check());
    constexpr absl::string_view kSeverities[] = {"", "info", "low", "medium", "high", "critical"};
    if (std::find(std::begin(kSeverities), std::end(kSeverities), severity_) ==
        std::end(kSeverities)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "--severity is `", severity_, "`; write info, low, medium, high or critical"));
    }
    if (rule_.size() > kRuleBytesMax) {
      return absl::InvalidArgumentError(
          absl::StrCat("--rule has ", rule_.size(), " bytes, limit ", kRuleBytesMax));
    }
    if (FindInvalidUtf8(rule_)) return absl::InvalidArgumentError("--rule is not valid UTF-8");
    if (since_.empty()) return absl::OkStatus();
    const absl::StatusOr<absl::Duration> since = ParseConfigDuration(since_);
    if (!since.ok()) {
      return absl::InvalidArgumentError(absl::StrCat("--since: ", since.status().message()));
    }
    within_ms_ = absl::ToInt64Milliseconds(*since);
    if (within_ms_ > 0) return absl::OkStatus();
    return absl::InvalidArgumentError("--since must be 1ms or longer");
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::ListAlertsRequest request;
    request.set_robot(robot_);
    request.set_limit(limit_);
    request.set_open(open_);
    request.set_severity(severity_);
    request.set_rule(rule_);
    request.set_within_ms(static_cast<uint64_t>(within_ms_));
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ListAlerts, request));
    if (env.json()) {
      return PrintJson(env, {{"alerts", JsonList(response.alerts(), AlertWithAck)},
                             {"cut", response.cut()},
                             {"limited", IsLimited(response)},
                             {"older_not_searched", response.older_not_searched()},
                             {"unrecorded", JsonList(response.unrecorded(), AlertWithAck)}});
    }
    const bool any_acked =
        std::any_of(response.alerts().begin(), response.alerts().end(),
                    [](const v1::Alert& alert) { return alert.has_acknowledged(); });
    std::vector<std::string> header = {"TIME", "ROBOT", "SEVERITY", "LEVEL", "RULE", "ID"};
    if (any_acked) header.push_back("ACKNOWLEDGED");
    header.push_back("TEXT");
    Table table(std::move(header));
    const auto add = [&table, any_acked](const v1::Alert& alert) {
      std::vector<std::string> row = {ShortTime(alert.time_unix_ns()),
                                      alert.robot(),
                                      alert.severity(),
                                      alert.level(),
                                      alert.rule(),
                                      ShortId(alert.id())};
      if (any_acked) row.push_back(AckCell(alert.acknowledged()));
      row.push_back(TextOf(alert));
      table.Add(std::move(row));
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
    if (IsLimited(response)) {
      env.out << "only the newest " << limit_ << " are shown; --limit shows more, at most 1000\n";
    }
    if (response.cut()) env.out << "older alerts do not fit into one response\n";
    if (response.older_not_searched()) {
      env.out << "older alerts were not searched: of all robots only the newest 20,000 are, with "
                 "--severity high or critical the newest 20,000 of these; name a ROBOT\n";
    }
    return ExitCode::kDone;
  }

 private:
  // There may be more than were asked for.
  bool IsLimited(const v1::ListAlertsResponse& response) const {
    return static_cast<uint32_t>(response.alerts_size() + response.unrecorded_size()) >= limit_;
  }

  static constexpr size_t kRuleBytesMax = 255;
  uint32_t limit_ = 100;
  bool open_ = false;
  std::string severity_;
  std::string rule_;
  std::string since_;
  // Of `since_`; 0 = any time.
  int64_t within_ms_ = 0;
};

class AckAlerts final : public Command {
 public:
  AckAlerts()
      : Command({"alert", "ack",
                 "Acknowledge alerts, all or none; changes no level, decision or rule"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("ID", ids_,
                   "Ids of alerts, or their first digits, as `alert list` shows them; at most 100")
        ->required();
    app.add_option("--note", note_, "Note, shown with the alerts; at most 1,000 bytes");
  }
  absl::Status Check() override {
    if (ids_.size() > kIdsMax) {
      return absl::InvalidArgumentError(
          absl::StrCat(ids_.size(), " ids are given, limit ", kIdsMax));
    }
    if (note_.size() > kNoteBytesMax) {
      return absl::InvalidArgumentError(
          absl::StrCat("--note has ", note_.size(), " bytes, limit ", kNoteBytesMax));
    }
    for (std::string& id : ids_) {
      id = absl::AsciiStrToLower(id);
      const bool hex = std::all_of(id.begin(), id.end(), [](char c) {
        return absl::ascii_isdigit(static_cast<unsigned char>(c)) || (c >= 'a' && c <= 'f');
      });
      if (hex && id.size() >= kAlertIdDigitsMin && id.size() <= kAlertIdDigitsMax) continue;
      return absl::InvalidArgumentError(
          absl::StrCat("`", EscapeText(id), "` is no ID of an alert: that has ", kAlertIdDigitsMax,
                       " digits 0-9a-f; write it, or its first ", kAlertIdDigitsMin, " or more"));
    }
    if (FindInvalidUtf8(note_)) return absl::InvalidArgumentError("--note is not valid UTF-8");
    return absl::OkStatus();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::AckAlertsRequest request;
    for (const std::string& id : ids_) request.add_alert_ids(id);
    request.set_note(note_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::AckAlerts, request));
    if (env.json()) {
      return PrintJson(env, {{"alerts", JsonList(response.alerts(), AckedJson)}});
    }
    for (const v1::AckedAlert& alert : response.alerts()) {
      env.out << EscapeText(ShortId(alert.alert_id())) << " (" << EscapeText(alert.robot()) << ", "
              << EscapeText(alert.rule()) << ") ";
      if (alert.already()) {
        env.out << "was acknowledged before, which stays: " << AckText(alert.acknowledged())
                << "\n";
      } else {
        env.out << "is acknowledged\n";
      }
    }
    return ExitCode::kDone;
  }

 private:
  static Json AckedJson(const v1::AckedAlert& alert) {
    return {{"id", alert.alert_id()},
            {"robot", alert.robot()},
            {"rule", alert.rule()},
            {"already", alert.already()},
            {"acknowledged", ToJson(alert.acknowledged())}};
  }

  std::vector<std::string> ids_;
  std::string note_;
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

Commands AlertCommands() { return MakeCommands<ListAlerts, WatchAlerts, AckAlerts>(); }

}  // namespace rips::ripsctl
