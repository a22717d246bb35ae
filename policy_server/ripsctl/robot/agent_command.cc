#include "policy_server/ripsctl/robot/agent_command.h"

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/printer.h"

namespace rips::ripsctl {
namespace {

class AgentCommand : public Command {
 public:
  absl::string_view noun() const final { return "agent"; }
};

class ListAgents final : public AgentCommand {
 public:
  absl::string_view verb() const override { return "list"; }
  absl::string_view synopsis() const override {
    return "Show the certificates that have connected since the server's start, and the bans";
  }
  void AddFlags(CLI::App&) override {}
  ExitCode Run(Env& env) override {
    const auto response = Call(env, &Stub::ListAgents, v1::ListAgentsRequest());
    if (!response.ok()) return Failed(env, response.status());
    if (env.json()) {
      Json agents = Json::array();
      for (const v1::AgentCertificate& agent : response->agents()) {
        agents.push_back({{"uri", agent.uri()},
                          {"serial", agent.serial()},
                          {"not_after", FullTime(agent.not_after_unix_ns())}});
      }
      Json bans = Json::array();
      for (const v1::CertificateBan& ban : response->bans()) {
        bans.push_back({{"uri", ban.uri()},
                        {"serial", ban.serial()},
                        {"reason", ban.reason()},
                        {"by", ban.by()},
                        {"time", FullTime(ban.time_unix_ns())}});
      }
      PrintJson({{"agents", std::move(agents)}, {"bans", std::move(bans)}}, env.out);
      return ExitCode::kDone;
    }
    Table agents({"IDENTITY", "SERIAL", "EXPIRES"});
    for (const v1::AgentCertificate& agent : response->agents()) {
      agents.Add({agent.uri(), agent.serial(), ShortTime(agent.not_after_unix_ns())});
    }
    agents.Print(env.out);
    if (response->bans().empty()) return ExitCode::kDone;
    Table bans({"BANNED", "SERIAL", "SINCE", "BY", "REASON"});
    for (const v1::CertificateBan& ban : response->bans()) {
      bans.Add({ban.uri(), ban.serial().empty() ? "all" : ban.serial(),
                ShortTime(ban.time_unix_ns()), ban.by(), ban.reason()});
    }
    bans.Print(env.out);
    return ExitCode::kDone;
  }
};

// `spiffe://...` and maybe a serial number.
class CertificateCommand : public AgentCommand {
 public:
  void AddFlags(CLI::App& app) override {
    app.add_option("URI", uri_, "Identity: spiffe://DOMAIN/robot/ROBOT/sensor/HOST")->required();
    app.add_option("--serial", serial_, "Only the certificate of this serial number, hex");
  }

 protected:
  ExitCode Print(Env& env, absl::string_view done) const {
    if (env.json()) {
      PrintJson({{"uri", uri_}, {"serial", serial()}, {"done", done}}, env.out);
    } else {
      env.out << EscapeText(uri_) << " " << done << "\n";
    }
    return ExitCode::kDone;
  }
  std::string serial() const {
    std::string lower = absl::AsciiStrToLower(serial_);
    const size_t digits = lower.find_first_not_of('0');
    return digits == std::string::npos ? lower : lower.substr(digits);
  }

  std::string uri_;
  std::string serial_;
};

class Ban final : public CertificateCommand {
 public:
  absl::string_view verb() const override { return "ban"; }
  absl::string_view synopsis() const override {
    return "Close an identity's connections and serve it no more";
  }
  void AddFlags(CLI::App& app) override {
    CertificateCommand::AddFlags(app);
    app.add_option("--reason", reason_, "Why; kept with the ban")->required();
  }
  ExitCode Run(Env& env) override {
    if (const absl::Status valid = CheckReason(reason_); !valid.ok()) {
      return UsageError(env, valid.message());
    }
    v1::BanRequest request;
    request.set_uri(uri_);
    request.set_serial(serial());
    request.set_reason(reason_);
    const auto response = Call(env, &Stub::Ban, request);
    return response.ok() ? Print(env, "banned") : Failed(env, response.status());
  }

 private:
  std::string reason_;
};

class Unban final : public CertificateCommand {
 public:
  absl::string_view verb() const override { return "unban"; }
  absl::string_view synopsis() const override { return "Serve a banned identity again"; }
  ExitCode Run(Env& env) override {
    v1::UnbanRequest request;
    request.set_uri(uri_);
    request.set_serial(serial());
    const auto response = Call(env, &Stub::Unban, request);
    return response.ok() ? Print(env, "unbanned") : Failed(env, response.status());
  }
};

// For an actuator that the server refuses because of the term that it has obeyed.
class ResetTerm final : public AgentCommand {
 public:
  absl::string_view verb() const override { return "reset-term"; }
  absl::string_view synopsis() const override {
    return "Accept an actuator that was refused because its term is far above the server's";
  }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id")->required();
    app.add_option("HOST", host_, "Host of the actuator")->required();
    app.add_option("--reason", reason_, "Why; kept in the robot's history")->required();
  }
  ExitCode Run(Env& env) override {
    absl::Status valid = CheckRobot(robot_);
    if (valid.ok()) valid = CheckReason(reason_);
    if (!valid.ok()) return UsageError(env, valid.message());
    v1::ResetTermRequest request;
    request.set_robot(robot_);
    request.set_host(host_);
    request.set_reason(reason_);
    const auto response = Call(env, &Stub::ResetTerm, request);
    if (!response.ok()) return Failed(env, response.status());
    const std::string decision = DecisionIdText(response->decision_id());
    if (env.json()) {
      PrintJson({{"robot", robot_},
                 {"host", host_},
                 {"decision_id", decision},
                 {"decided_level", response->decided_level()}},
                env.out);
    } else {
      env.out << robot_ << " stays at " << EscapeText(response->decided_level()) << " by decision "
              << decision << "; actuator " << EscapeText(host_)
              << " is armed when it connects next, within 60 s\n";
    }
    return ExitCode::kDone;
  }

 private:
  std::string robot_;
  std::string host_;
  std::string reason_;
};

}  // namespace

Commands AgentCommands() {
  Commands commands;
  commands.push_back(std::make_unique<ListAgents>());
  commands.push_back(std::make_unique<Ban>());
  commands.push_back(std::make_unique<Unban>());
  commands.push_back(std::make_unique<ResetTerm>());
  return commands;
}

}  // namespace rips::ripsctl
