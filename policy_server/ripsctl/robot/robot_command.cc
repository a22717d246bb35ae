// `ripsctl robot`: list, watch, show, graph.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstddef>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/keep_watching.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/robot_level.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/robot/agent_contact_text.h"
#include "policy_server/ripsctl/robot/graph_view.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

// What is wrong, in one line, behind a maintenance that may be why; it says so where the server has
// left something out.
std::string DegradedText(const v1::RobotStatus& status) {
  std::string text = MaintenanceText(status);
  if (!text.empty() && !status.degraded().empty()) text += "; ";
  absl::StrAppend(&text, absl::StrJoin(status.degraded(), "; "));
  if (status.degraded_cut()) {
    absl::StrAppend(&text, text.empty() ? "" : "; ",
                    "(more than fits here; see `ripsctl level show ", status.robot(), "`)");
  }
  return text;
}

class ListRobots final : public Command {
 public:
  ListRobots()
      : Command({"robot", "list",
                 "Show all robots, their levels, and when the agent silent longest was heard"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("--label", labels_,
                   "Only robots that have all of these labels in the inventory, each KEY=VALUE");
  }
  absl::Status Check() override {
    for (const std::string& label : labels_) {
      RIPS_RETURN_IF_ERROR(bundle::ParseLabel(label).status());
    }
    return absl::OkStatus();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::ListRobotsRequest request;
    for (const std::string& label : labels_) request.add_labels(label);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ListRobots, request));
    if (!labels_.empty() && response.robots().empty() && response.no_answer().empty()) {
      return absl::NotFoundError(
          absl::StrCat("the inventory has no robot with ", absl::StrJoin(labels_, " ")));
    }
    const ExitCode code = response.no_answer().empty() ? ExitCode::kDone : ExitCode::kRefused;
    if (env.json()) {
      PrintJson({{"robots", JsonList(response.robots())},
                 {"no_answer", JsonList(response.no_answer())},
                 {"server_version", response.server_version()}},
                env.out);
      return code;
    }
    PrintTable(response, env.out);
    return code;
  }

 private:
  static void PrintTable(const v1::ListRobotsResponse& response, TextStream out) {
    const std::string& version = response.server_version();
    bool other_version = false;
    Table table(
        {"ROBOT", "DECIDED", "EFFECTIVE", "STAGE", "DECISION", "BUNDLE", "HEARD", "DEGRADED"});
    for (const v1::RobotStatus& status : response.robots()) {
      table.Add({status.robot(), status.decided_level(), status.effective_level(),
                 StageAndPending(status), DecisionIdText(status.decision_id()),
                 ShortBundle(status.bundle_version()), OldestContact(status, version),
                 DegradedText(status)});
      other_version |= HasOtherVersion(status, version);
    }
    for (const std::string& robot : response.no_answer()) {
      table.Add({robot, "", "", "", "", "", "", "no response in time: the server is overloaded"});
    }
    table.Print(out);
    if (!response.robots().empty()) {
      out << "why a robot is at its level, and what to do: ripsctl explain ROBOT\n";
    }
    PrintFindings(response, out);
    if (!other_version) return;
    out << "* an agent has another version than the server, " << EscapeText(version)
        << "; see `ripsctl robot show`\n";
  }

  // Robots on which findings stand, or may. Silent on an older server, which does not say.
  static void PrintFindings(const v1::ListRobotsResponse& response, TextStream out) {
    std::vector<std::string> standing;
    std::vector<std::string> not_known;
    for (const v1::RobotStatus& status : response.robots()) {
      if (status.findings() > 0) {
        standing.push_back(absl::StrCat(status.robot(), " (", status.findings(),
                                        status.findings_not_known() ? " as reported last)" : ")"));
      } else if (status.findings_not_known()) {
        not_known.push_back(status.robot());
      }
    }
    if (!standing.empty()) {
      out << "findings stand on " << EscapeText(InBrief(standing))
          << ": ripsctl robot coverage ROBOT\n";
    }
    if (!not_known.empty()) {
      out << "whether findings stand is not known of " << EscapeText(InBrief(not_known)) << "\n";
    }
  }
  static std::string InBrief(const std::vector<std::string>& names) {
    const size_t shown = std::min(names.size(), kNamesShown);
    const std::string text =
        absl::StrJoin(names.begin(), names.begin() + static_cast<ptrdiff_t>(shown), ", ");
    return shown == names.size() ? text
                                 : absl::StrCat(text, " and ", names.size() - shown, " more");
  }

  // Robots named in one line below the table.
  static constexpr size_t kNamesShown = 8;
  std::vector<std::string> labels_;
};

class WatchRobots final : public Command {
 public:
  WatchRobots()
      : Command({"robot", "watch", "Show all robots, then each change, reconnecting when needed"}) {
  }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robots_, "Robot ids; default: all");
  }
  absl::Status Check() override {
    for (const std::string& robot : robots_) RIPS_RETURN_IF_ERROR(CheckRobot(robot));
    return absl::OkStatus();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::WatchRobotsRequest request;
    for (const std::string& robot : robots_) request.add_robots(robot);
    const auto open = [&](grpc::ClientContext* context) {
      return env.server->WatchRobots(context, request);
    };
    RIPS_RETURN_IF_ERROR(Watch<v1::RobotStatus>(
        env, open, [&](const v1::RobotStatus& status) { Print(env, status); }));
    return ExitCode::kDone;
  }

 private:
  // One line each, so not a table. When it came, by this machine's clock.
  static void Print(Env& env, const v1::RobotStatus& status) {
    if (env.json()) return PrintJson(ToJson(status), env.out);
    env.out << ShortTime(absl::GetCurrentTimeNanos()) << "  " << EscapeText(status.robot())
            << "  decided " << EscapeText(status.decided_level()) << "  effective "
            << (status.effective_level().empty() ? "-" : EscapeText(status.effective_level()))
            << "  " << EscapeText(StageAndPending(status)) << "  decision "
            << DecisionIdText(status.decision_id());
    if (const std::string text = DegradedText(status); !text.empty()) {
      env.out << "  degraded: " << EscapeText(text);
    }
    env.out << std::endl;
  }

  std::vector<std::string> robots_;
};

class ShowRobot final : public RobotCommand {
 public:
  ShowRobot() : RobotCommand({"robot", "show", "Show one robot in detail"}) {}
  absl::StatusOr<ExitCode> Run(Env& env) override {
    RIPS_ASSIGN_OR_RETURN(const auto response,
                          Call(env, &Stub::ListRobots, v1::ListRobotsRequest()));
    for (const v1::RobotStatus& status : response.robots()) {
      if (status.robot() == robot_) return Print(env, status, response.server_version());
    }
    for (const std::string& silent : response.no_answer()) {
      if (silent != robot_) continue;
      return absl::ResourceExhaustedError(
          absl::StrCat("robot `", robot_,
                       "` did not respond in time: the server is overloaded; its level stands, see "
                       "`ripsctl level history ",
                       robot_, "`"));
    }
    return absl::NotFoundError(
        absl::StrCat("robot `", robot_, "` is not in the inventory; see `ripsctl robot list`"));
  }

 private:
  static ExitCode Print(Env& env, const v1::RobotStatus& status, absl::string_view server_version) {
    if (env.json()) return PrintJson(env, ToJson(status));
    Table table = StatusTable(status);
    table.Add({"bundle", status.bundle_version()});
    for (const v1::AgentContact& agent : status.agents()) {
      table.Add({"agent", AgentText(agent, server_version)});
    }
    if (status.has_findings()) table.Add({"findings", FindingsText(status)});
    for (const std::string& each : status.degraded()) table.Add({"degraded", each});
    if (status.degraded_cut()) {
      table.Add({"degraded", "(more than fits here; see `ripsctl level show`)"});
    }
    table.Print(env.out);
    return ExitCode::kDone;
  }
  static std::string FindingsText(const v1::RobotStatus& status) {
    if (status.findings() > 0) {
      return absl::StrCat(status.findings(),
                          status.findings_not_known() ? " stood as reported last" : " stand",
                          "; see `ripsctl robot coverage ", status.robot(), "`");
    }
    return status.findings_not_known()
               ? absl::StrCat("not known; see `ripsctl explain ", status.robot(), "`")
               : "none stands";
  }
};

class ShowGraph final : public RobotCommand {
 public:
  ShowGraph()
      : RobotCommand({"robot", "graph", "Show the ROS graph as the policy server sees it"}) {}
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::GetGraphRequest request;
    request.set_robot(robot_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::GetGraph, request));
    if (env.json()) {
      Json graph = GraphJson(response.graph());
      if (response.left_out() > 0) graph["left_out"] = response.left_out();
      return PrintJson(env, graph);
    }
    if (response.changed_unix_ns() == 0) {
      env.out << "no graph yet; is the robot's sensor connected?\n";
      return ExitCode::kDone;
    }
    env.out << "changed " << ShortTime(response.changed_unix_ns())
            << (response.graph().settled() ? "" : ", discovery not settled") << "\n";
    PrintGraph(response.graph(), env.out);
    if (response.left_out() > 0) {
      env.out << response.left_out()
              << " endpoints, nodes and participants do not fit into one response\n";
    }
    return ExitCode::kDone;
  }
};

}  // namespace

Commands RobotCommands() { return MakeCommands<ListRobots, WatchRobots, ShowRobot, ShowGraph>(); }

}  // namespace rips::ripsctl
