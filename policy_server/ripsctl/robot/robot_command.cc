#include "policy_server/ripsctl/robot/robot_command.h"

#include <CLI/CLI.hpp>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/keep_watching.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/server_expiry.h"
#include "policy_server/ripsctl/robot/robot_actuators.h"
#include "policy_server/ripsctl/robot/robot_coverage.h"

namespace rips::ripsctl {
namespace {

class RobotCommand : public Command {
 public:
  absl::string_view noun() const final { return "robot"; }
};

Table StatusTable() {
  return Table({"ROBOT", "DECIDED", "EFFECTIVE", "STAGE", "MARK", "BUNDLE", "DEGRADED"});
}

// What is wrong, in one line; it says so where the server has left something out.
std::string DegradedText(const v1::RobotStatus& status) {
  std::string text = absl::StrJoin(status.degraded(), "; ");
  if (status.degraded_cut()) {
    absl::StrAppend(&text, text.empty() ? "" : "; ",
                    "(more than fits here; see `ripsctl level show ", status.robot(), "`)");
  }
  return text;
}

void AddStatus(const v1::RobotStatus& status, Table* table) {
  table->Add({status.robot(), status.decided_level(), status.effective_level(), status.stage(),
              DecisionIdText(status.decision_id()), ShortBundle(status.bundle_version()),
              DegradedText(status)});
}

class ListRobots final : public RobotCommand {
 public:
  absl::string_view verb() const override { return "list"; }
  absl::string_view synopsis() const override { return "Show all robots and their levels"; }
  void AddFlags(CLI::App&) override {}
  ExitCode Run(Env& env) override {
    const auto response = Call(env, &Stub::ListRobots, v1::ListRobotsRequest());
    if (!response.ok()) return Failed(env, response.status());
    if (env.json()) {
      Json robots = Json::array();
      for (const v1::RobotStatus& status : response->robots()) robots.push_back(ToJson(status));
      Json silent = Json::array();
      for (const std::string& robot : response->no_answer()) silent.push_back(robot);
      PrintJson({{"robots", std::move(robots)}, {"no_answer", std::move(silent)}}, env.out);
      return response->no_answer().empty() ? ExitCode::kDone : ExitCode::kRefused;
    }
    Table table = StatusTable();
    for (const v1::RobotStatus& status : response->robots()) AddStatus(status, &table);
    for (const std::string& robot : response->no_answer()) {
      table.Add({robot, "", "", "", "", "", "no answer in time: the server is too busy with it"});
    }
    table.Print(env.out);
    return response->no_answer().empty() ? ExitCode::kDone : ExitCode::kRefused;
  }
};

class WatchRobots final : public RobotCommand {
 public:
  absl::string_view verb() const override { return "watch"; }
  absl::string_view synopsis() const override {
    return "Show all robots, then each change, reconnecting when needed";
  }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robots_, "Robots to watch; none = all");
  }
  ExitCode Run(Env& env) override {
    v1::WatchRobotsRequest request;
    for (const std::string& robot : robots_) {
      if (const absl::Status valid = CheckRobot(robot); !valid.ok()) {
        return UsageError(env, valid.message());
      }
      request.add_robots(robot);
    }
    return KeepWatching(env, [&](bool again, const std::function<void()>& heard) {
      grpc::ClientContext context;
      context.set_wait_for_ready(again);
      const auto reader = env.server->WatchRobots(&context, request);
      ServerExpiry expiry(&context);
      v1::RobotStatus status;
      while (reader->Read(&status)) {
        heard();
        expiry.Received();
        Print(env, status);
      }
      return expiry.End(reader->Finish());
    });
  }

 private:
  // One line each, so not a table. When it came, by this machine's clock.
  static void Print(Env& env, const v1::RobotStatus& status) {
    if (env.json()) return PrintJson(ToJson(status), env.out);
    env.out << ShortTime(absl::GetCurrentTimeNanos()) << "  " << EscapeText(status.robot())
            << "  decided " << EscapeText(status.decided_level()) << "  effective "
            << (status.effective_level().empty() ? "-" : EscapeText(status.effective_level()))
            << "  " << EscapeText(status.stage()) << "  decision "
            << DecisionIdText(status.decision_id());
    if (const std::string text = DegradedText(status); !text.empty()) {
      env.out << "  degraded: " << EscapeText(text);
    }
    env.out << std::endl;
  }

  std::vector<std::string> robots_;
};

// A verb that takes one robot.
class OneRobotCommand : public RobotCommand {
 public:
  void AddFlags(CLI::App& app) final { app.add_option("ROBOT", robot_, "Robot id")->required(); }
  ExitCode Run(Env& env) final {
    const absl::Status valid = CheckRobot(robot_);
    return valid.ok() ? RunFor(env, robot_) : UsageError(env, valid.message());
  }

 protected:
  virtual ExitCode RunFor(Env& env, const std::string& robot) = 0;

 private:
  std::string robot_;
};

class ShowRobot final : public OneRobotCommand {
 public:
  absl::string_view verb() const override { return "show"; }
  absl::string_view synopsis() const override { return "Show one robot in detail"; }

 private:
  ExitCode RunFor(Env& env, const std::string& robot) override {
    v1::ListRobotsRequest request;
    const auto response = Call(env, &Stub::ListRobots, request);
    if (!response.ok()) return Failed(env, response.status());
    for (const v1::RobotStatus& status : response->robots()) {
      if (status.robot() == robot) return Print(env, status);
    }
    for (const std::string& silent : response->no_answer()) {
      if (silent != robot) continue;
      return Failed(env, absl::ResourceExhaustedError(absl::StrCat(
                             "robot `", robot,
                             "` did not answer in time: the server is too busy with it; its level "
                             "stands, see `ripsctl level history ",
                             robot, "`")));
    }
    return Failed(env,
                  absl::NotFoundError(absl::StrCat(
                      "robot `", robot, "` is not in the inventory; see `ripsctl robot list`")));
  }
  static ExitCode Print(Env& env, const v1::RobotStatus& status) {
    if (env.json()) {
      PrintJson(ToJson(status), env.out);
      return ExitCode::kDone;
    }
    Table table({"robot", EscapeText(status.robot())});
    table.Add({"decided level", status.decided_level()});
    table.Add({"effective level", status.effective_level()});
    table.Add({"stage", status.stage()});
    table.Add({"decision", DecisionIdText(status.decision_id())});
    table.Add({"bundle", status.bundle_version()});
    for (const std::string& each : status.degraded()) table.Add({"degraded", each});
    if (status.degraded_cut()) {
      table.Add({"degraded", "(more than fits here; see `ripsctl level show`)"});
    }
    table.Print(env.out);
    return ExitCode::kDone;
  }
};

class ShowGraph final : public OneRobotCommand {
 public:
  absl::string_view verb() const override { return "graph"; }
  absl::string_view synopsis() const override {
    return "Show the ROS graph as the policy server sees it";
  }

 private:
  ExitCode RunFor(Env& env, const std::string& robot) override {
    v1::GetGraphRequest request;
    request.set_robot(robot);
    const auto response = Call(env, &Stub::GetGraph, request);
    if (!response.ok()) return Failed(env, response.status());
    Json graph = ToJson(response->graph());
    if (response->left_out() > 0) graph["left_out"] = response->left_out();
    if (env.json()) {
      PrintJson(graph, env.out);
      return ExitCode::kDone;
    }
    if (response->changed_unix_ns() == 0) {
      env.out << "no graph yet; is the robot's sensor connected?\n";
      return ExitCode::kDone;
    }
    env.out << "changed " << ShortTime(response->changed_unix_ns())
            << (response->graph().settled() ? "" : ", discovery not settled") << "\n";
    PrintText(graph, env.out);
    if (response->left_out() > 0) {
      env.out << response->left_out()
              << " endpoints, nodes and participants do not fit into one answer\n";
    }
    return ExitCode::kDone;
  }

  static std::string Joined(const Json& names) {
    std::vector<std::string> list;
    for (const Json& name : names) list.push_back(name.get<std::string>());
    return absl::StrJoin(list, ", ");
  }
  static void PrintText(const Json& graph, std::ostream& out) {
    out << "\n";
    Table nodes({"NODE", "SERVICES"});
    for (const Json& node : graph["nodes"]) {
      nodes.Add({node["name"].get<std::string>(), Joined(node["services"])});
    }
    nodes.Print(out);
    out << "\n";
    Table topics({"TOPIC", "TYPES", "PUBLISHERS", "SUBSCRIBERS"});
    for (const Json& topic : graph["topics"]) {
      topics.Add({topic["name"].get<std::string>(), Joined(topic["types"]),
                  Joined(topic["publishers"]), Joined(topic["subscribers"])});
    }
    topics.Print(out);
    if (graph["unattributed"].empty()) return;
    out << "\n";
    Table others({"WITHOUT A NODE", "KIND", "GUID"});
    for (const Json& each : graph["unattributed"]) {
      others.Add({each["topic"].get<std::string>(), each["kind"].get<std::string>(),
                  each["guid"].get<std::string>()});
    }
    others.Print(out);
  }
};

}  // namespace

Commands RobotCommands() {
  Commands commands;
  commands.push_back(std::make_unique<ListRobots>());
  commands.push_back(std::make_unique<WatchRobots>());
  commands.push_back(std::make_unique<ShowRobot>());
  commands.push_back(std::make_unique<ShowGraph>());
  for (const auto more : {CoverageCommands, ActuatorCommands}) {
    for (std::unique_ptr<Command>& command : more()) commands.push_back(std::move(command));
  }
  return commands;
}

}  // namespace rips::ripsctl
