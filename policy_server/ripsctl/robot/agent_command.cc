// `ripsctl agent`: list, ban, unban, reset-term.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/ascii.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

class ListAgents final : public Command {
 public:
  ListAgents()
      : Command({"agent", "list",
                 "List the newest certificate of each identity, seen or issued since the server "
                 "started; all bans"}) {}
  absl::StatusOr<ExitCode> Run(Env& env) override {
    RIPS_ASSIGN_OR_RETURN(const auto response,
                          Call(env, &Stub::ListAgents, v1::ListAgentsRequest()));
    if (env.json()) return PrintJson(env, ResponseJson(response));
    Table agents({"IDENTITY", "SERIAL", "EXPIRES"});
    for (const v1::AgentCertificate& agent : response.agents()) {
      agents.Add({agent.uri(), agent.serial(), ShortTime(agent.not_after_unix_ns())});
    }
    agents.Print(env.out);
    if (response.bans().empty()) return ExitCode::kDone;
    Table bans({"BANNED", "SERIAL", "SINCE", "BY", "REASON"});
    for (const v1::CertificateBan& ban : response.bans()) {
      bans.Add({ban.uri(), ban.serial().empty() ? "all" : ban.serial(),
                ShortTime(ban.time_unix_ns()), ban.by(), ban.reason()});
    }
    bans.Print(env.out);
    return ExitCode::kDone;
  }

 private:
  static Json ResponseJson(const v1::ListAgentsResponse& response) {
    const auto agent_json = [](const v1::AgentCertificate& agent) -> Json {
      return {{"uri", agent.uri()},
              {"serial", agent.serial()},
              {"not_after", FullTime(agent.not_after_unix_ns())}};
    };
    const auto ban_json = [](const v1::CertificateBan& ban) -> Json {
      return {{"uri", ban.uri()},
              {"serial", ban.serial()},
              {"reason", ban.reason()},
              {"by", ban.by()},
              {"time", FullTime(ban.time_unix_ns())}};
    };
    return {{"agents", JsonList(response.agents(), agent_json)},
            {"bans", JsonList(response.bans(), ban_json)}};
  }
};

// `spiffe://...` and maybe a serial number.
class CertificateCommand : public Command {
 public:
  using Command::Command;
  void AddFlags(CLI::App& app) override {
    app.add_option("URI", uri_, "Identity: spiffe://DOMAIN/robot/ROBOT/sensor/HOST")->required();
    app.add_option("--serial", serial_,
                   "Only the certificate with this serial number, hexadecimal");
  }

 protected:
  ExitCode Print(Env& env, absl::string_view done) const {
    if (env.json()) return PrintJson(env, {{"uri", uri_}, {"serial", serial()}, {"done", done}});
    env.out << EscapeText(uri_) << " " << done << "\n";
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
  Ban()
      : CertificateCommand(
            {"agent", "ban", "Close an identity's connections and refuse new ones"}) {}
  void AddFlags(CLI::App& app) override {
    CertificateCommand::AddFlags(app);
    app.add_option("--reason", reason_, "Reason, recorded with the ban")->required();
  }
  absl::Status Check() override { return CheckReason(reason_); }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::BanRequest request;
    request.set_uri(uri_);
    request.set_serial(serial());
    request.set_reason(reason_);
    RIPS_RETURN_IF_ERROR(Call(env, &Stub::Ban, request).status());
    const ExitCode code = Print(env, "banned");
    if (!env.json() && !MayHaveBeenSeen(env)) {
      env.out << "no certificate of this identity was seen since the server started: is it one of "
                 "`ripsctl agent list`?\n";
    }
    return code;
  }

 private:
  // One that was not may be banned, too; but it may also be a slip.
  bool MayHaveBeenSeen(Env& env) const {
    const auto known = Call(env, &Stub::ListAgents, v1::ListAgentsRequest());
    return !known.ok() ||
           std::any_of(known->agents().begin(), known->agents().end(),
                       [this](const v1::AgentCertificate& each) { return each.uri() == uri_; });
  }

  std::string reason_;
};

class Unban final : public CertificateCommand {
 public:
  Unban() : CertificateCommand({"agent", "unban", "Lift the ban of an identity"}) {}
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::UnbanRequest request;
    request.set_uri(uri_);
    request.set_serial(serial());
    RIPS_RETURN_IF_ERROR(Call(env, &Stub::Unban, request).status());
    return Print(env, "unbanned");
  }
};

// For an actuator that the server refuses because of the term that it has obeyed.
class ResetTerm final : public RobotCommand {
 public:
  ResetTerm()
      : RobotCommand(
            {"agent", "reset-term",
             "Accept an actuator that was refused because its term is far above the server's"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("HOST", host_, "Host of the actuator")->required();
    app.add_option("--reason", reason_, "Reason, recorded in the robot's history")->required();
  }
  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(RobotCommand::Check());
    return CheckReason(reason_);
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::ResetTermRequest request;
    request.set_robot(robot_);
    request.set_host(host_);
    request.set_reason(reason_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ResetTerm, request));
    const std::string decision = DecisionIdText(response.decision_id());
    if (env.json()) {
      return PrintJson(env, {{"robot", robot_},
                             {"host", host_},
                             {"decision_id", decision},
                             {"decided_level", response.decided_level()}});
    }
    env.out << robot_ << " stays at " << EscapeText(response.decided_level()) << " by decision "
            << decision << "; actuator " << EscapeText(host_)
            << " is armed when it connects next, within 60 s\n";
    return ExitCode::kDone;
  }

 private:
  std::string host_;
  std::string reason_;
};

}  // namespace

Commands AgentCommands() { return MakeCommands<ListAgents, Ban, Unban, ResetTerm>(); }

}  // namespace rips::ripsctl
