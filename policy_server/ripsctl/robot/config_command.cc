// `ripsctl robot config`: the settings in force on the server and on a robot's agents, and what
// says each. What an agent says of itself is untrusted.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

// With each space after another one escaped: in a line that a terminal wraps, a gap as wide as the
// terminal would make what an agent says look like a line of ours.
std::string WithoutGaps(absl::string_view text) {
  std::string out;
  for (const char c : text) {
    const bool gap =
        c == ' ' && !out.empty() && (out.back() == ' ' || absl::EndsWith(out, "\\x20"));
    absl::StrAppend(&out, gap ? "\\x20" : std::string(1, c));
  }
  return out;
}

class ShowConfiguration final : public Command {
 public:
  ShowConfiguration()
      : Command({"robot", "config",
                 "Show the settings in force, and what says each (role operator)"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id");
    app.add_flag("--policy-server", own_,
                 "The policy server's own settings, in place of a robot's");
    app.add_flag("--no-defaults", no_defaults_, "Leave out what no file says");
  }
  absl::Status Check() override {
    if (!own_ && robot_.empty()) {
      return absl::InvalidArgumentError(
          "name a robot, one of `ripsctl robot list`, or write --policy-server");
    }
    if (!own_) return CheckRobot(robot_);
    if (robot_.empty()) return absl::OkStatus();
    return absl::InvalidArgumentError("--policy-server goes with no ROBOT");
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::GetConfigurationRequest request;
    request.set_robot(robot_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::GetConfiguration, request));
    if (env.json()) return PrintJson(env, ToJson(response));
    env.out << (own_ ? "policy server" : "inventory of the policy server") << "\n";
    Print(response.server(), env.out);
    for (const v1::AgentConfiguration& agent : response.agents()) {
      env.out << "\n" << EscapeText(agent.role()) << " " << EscapeText(agent.host());
      if (agent.has_configuration()) {
        env.out << ", as it said when it connected, at " << ShortTime(agent.said_unix_ns()) << "\n";
        Print(agent.configuration(), env.out);
      } else {
        env.out
            << "\n  not known: it has not connected since the policy server started, or is of an "
               "older version\n";
      }
    }
    if (!response.agents().empty()) {
      env.out
          << "\nwhat an agent says of itself proves nothing: one whose key was stolen may lie\n";
    }
    return ExitCode::kDone;
  }

 private:
  void Print(const v1::Configuration& configuration, TextStream out) const {
    Table table({"SETTING", "VALUE", "FROM"});
    size_t defaults = 0;
    for (const v1::Setting& each : configuration.settings()) {
      if (each.source().empty() && no_defaults_) {
        ++defaults;
      } else {
        table.Add({WithoutGaps(each.path()), WithoutGaps(each.value()),
                   each.source().empty() ? "default" : WithoutGaps(each.source())});
      }
    }
    table.Print(out, "  ");
    for (const std::string& refused : configuration.refused()) {
      out << "  not followed: " << WithoutGaps(EscapeText(refused)) << "\n";
    }
    if (defaults > 0) {
      out << "  and " << defaults << (defaults == 1 ? " default\n" : " defaults\n");
    }
    if (configuration.left_out() > 0) {
      out << "  and " << configuration.left_out() << " more, for which there was no room; "
          << "`--check-config` of the program shows all\n";
    }
  }

  Json ToJson(const v1::Configuration& configuration) const {
    Json settings = Json::array();
    size_t defaults = 0;
    for (const v1::Setting& each : configuration.settings()) {
      if (each.source().empty() && no_defaults_) {
        ++defaults;
        continue;
      }
      settings.push_back({{"path", each.path()},
                          {"value", each.value()},
                          {"source", each.source().empty() ? Json(nullptr) : Json(each.source())}});
    }
    return {{"settings", std::move(settings)},
            {"refused", configuration.refused()},
            {"defaults_left_out", defaults},
            {"left_out", configuration.left_out()}};
  }

  Json ToJson(const v1::GetConfigurationResponse& response) const {
    Json agents = Json::array();
    for (const v1::AgentConfiguration& agent : response.agents()) {
      agents.push_back({{"role", agent.role()},
                        {"host", agent.host()},
                        {"said", agent.has_configuration() ? Json(FullTime(agent.said_unix_ns()))
                                                           : Json(nullptr)},
                        {"configuration", agent.has_configuration() ? ToJson(agent.configuration())
                                                                    : Json(nullptr)}});
    }
    return {{"robot", own_ ? Json(nullptr) : Json(robot_)},
            {"server", ToJson(response.server())},
            {"agents", std::move(agents)}};
  }

  std::string robot_;
  bool own_ = false;
  bool no_defaults_ = false;
};

}  // namespace

Commands ConfigCommands() { return MakeCommands<ShowConfiguration>(); }

}  // namespace rips::ripsctl
