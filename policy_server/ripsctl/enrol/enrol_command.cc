// `ripsctl enrol`: create-token, revoke-token, list.
#include <fcntl.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cerrno>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/enrol/token_text.h"
#include "services/pki/key_request.h"
#include "services/runtime/atomic_file.h"
#include "services/runtime/config_reader.h"
#include "services/runtime/config_sections.h"
#include "services/runtime/unique_fd.h"

namespace rips::ripsctl {
namespace {

constexpr absl::Duration kValidMin = absl::Minutes(1);
constexpr absl::Duration kValidMax = absl::Hours(24);

// A new file that only its owner can read, on the disk when it returns.
absl::Status WriteSecret(const std::string& path, const std::string& text) {
  const UniqueFd fd(open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW, 0600));
  if (fd.get() < 0) return absl::ErrnoToStatus(errno, absl::StrCat("cannot make `", path, "`"));
  const ssize_t written = write(fd.get(), text.data(), text.size());
  if (written == static_cast<ssize_t>(text.size()) && fsync(fd.get()) == 0) return absl::OkStatus();
  const int error = written < 0 ? errno : ENOSPC;
  unlink(path.c_str());
  return absl::ErrnoToStatus(error, absl::StrCat("cannot write `", path, "`"));
}

bool IsLoopback(const std::string& server) {
  return absl::StartsWith(server, "127.") || absl::StartsWith(server, "localhost:") ||
         absl::StartsWith(server, "[::1]");
}

class CreateToken final : public RobotCommand {
 public:
  CreateToken()
      : RobotCommand({"enrol", "create-token",
                      "Make a token with which a robot's host fetches its certificates"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("HOST", host_, "Host of the robot, as the inventory names it")->required();
    app.add_option("--role", roles_,
                   "sensor or actuator; both, as far as the inventory lists them, if left out");
    app.add_option("--valid", valid_, "How long it can be used: 1min to 24h")
        ->capture_default_str();
    app.add_option("--address", address_,
                   "HOST:PORT of the policy server as the robot reaches it; --server if left out");
    app.add_option("--out", out_, "New file for the token; else it is printed");
  }
  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(RobotCommand::Check());
    RIPS_RETURN_IF_ERROR(ValidateName("host", host_));
    for (const std::string& role : roles_) {
      if (role != "sensor" && role != "actuator") {
        return absl::InvalidArgumentError("--role is `sensor` or `actuator`");
      }
    }
    if (!address_.empty() && !IsHostPort(address_)) {
      return absl::InvalidArgumentError("--address must be HOST:PORT");
    }
    const absl::StatusOr<absl::Duration> valid = ParseConfigDuration(valid_);
    if (!valid.ok()) {
      return absl::InvalidArgumentError(absl::StrCat("--valid: ", valid.status().message()));
    }
    if (*valid < kValidMin || *valid > kValidMax) {
      return absl::InvalidArgumentError("--valid must be 1min to 24h");
    }
    valid_ms_ = static_cast<uint64_t>(absl::ToInt64Milliseconds(*valid));
    return absl::OkStatus();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    // Before there is a token, so that none is lost.
    if (!out_.empty()) RIPS_RETURN_IF_ERROR(FileError(WriteSecret(out_, "")));
    absl::StatusOr<ExitCode> code = Make(env);
    if (!code.ok() && !out_.empty()) unlink(out_.c_str());
    return code;
  }

 private:
  absl::StatusOr<ExitCode> Make(Env& env) {
    RIPS_ASSIGN_OR_RETURN(const std::string key, pki::NewKey());
    v1::CreateEnrolmentTokenRequest request;
    request.set_robot(robot_);
    request.set_host(host_);
    for (const std::string& role : roles_) request.add_roles(role);
    request.set_valid_ms(valid_ms_);
    RIPS_ASSIGN_OR_RETURN(*request.mutable_request_pem(), pki::RequestFor(key));
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::CreateEnrolmentToken, request));
    v1::EnrolmentToken token;
    token.set_id(response.id());
    token.set_server(address_.empty() ? env.settings.server : address_);
    token.set_robot(robot_);
    token.set_host(host_);
    *token.mutable_roles() = response.roles();
    token.set_expires_unix_ns(response.expires_unix_ns());
    token.set_authorities_pem(response.authorities_pem());
    token.set_certificates_pem(response.certificates_pem());
    token.set_key_pem(key);
    const std::string text = enrol::FormatToken(token);
    if (!out_.empty()) RIPS_RETURN_IF_ERROR(FileError(WriteFileAtomically(out_, text + "\n")));
    if (env.json()) {
      Json json = {{"id", token.id()},
                   {"robot", robot_},
                   {"host", host_},
                   {"roles", std::vector<std::string>(token.roles().begin(), token.roles().end())},
                   {"server", token.server()},
                   {"expires", FullTime(token.expires_unix_ns())},
                   {"token", out_.empty() ? Json(text) : Json(nullptr)}};
      return PrintJson(env, json);
    }
    // The token alone on standard output, so that it can go into a pipe.
    if (out_.empty()) env.out << text << "\n";
    env.err << "Token " << token.id() << " for " << absl::StrJoin(token.roles(), " and ") << " of "
            << robot_ << " on " << host_ << ", once each, until "
            << ShortTime(token.expires_unix_ns()) << ". It is secret.\n"
            << "On the robot, as root: rips-enrol fetch --token "
            << (out_.empty() ? std::string("FILE") : out_) << "\n";
    if (IsLoopback(token.server())) {
      env.err << "warning: the robot will look for the server at " << token.server()
              << ", which is itself; see --address\n";
    }
    return ExitCode::kDone;
  }

  std::string host_;
  std::vector<std::string> roles_;
  std::string valid_ = "1h";
  std::string address_;
  std::string out_;
  uint64_t valid_ms_ = 0;
};

class RevokeToken final : public Command {
 public:
  RevokeToken()
      : Command({"enrol", "revoke-token",
                 "Make a token useless; certificates fetched with it stay good"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("ID", id_, "Id of the token, as `enrol list` shows it")->required();
  }
  absl::Status Check() override { return ValidateName("token id", id_); }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::RevokeEnrolmentTokenRequest request;
    request.set_id(id_);
    RIPS_RETURN_IF_ERROR(Call(env, &Stub::RevokeEnrolmentToken, request).status());
    if (env.json()) return PrintJson(env, {{"id", id_}, {"done", "revoked"}});
    env.out << "token " << EscapeText(id_) << " is revoked\n";
    return ExitCode::kDone;
  }

 private:
  std::string id_;
};

class ListEnrolments final : public Command {
 public:
  ListEnrolments()
      : Command({"enrol", "list", "List tokens, and the certificates that the server issued"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id; all if left out");
  }
  absl::Status Check() override { return robot_.empty() ? absl::OkStatus() : CheckRobot(robot_); }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::ListEnrolmentsRequest request;
    request.set_robot(robot_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ListEnrolments, request));
    if (env.json()) {
      return PrintJson(env, {{"tokens", JsonList(response.tokens(), TokenJson)},
                             {"issued", JsonList(response.issued(), IssuedJson)},
                             {"cut", response.cut()}});
    }
    Table tokens({"TOKEN", "ROBOT", "HOST", "FOR", "USED", "EXPIRES", "STATE", "BY"});
    for (const v1::TokenState& token : response.tokens()) {
      tokens.Add({token.id(), token.robot(), token.host(), absl::StrJoin(token.roles(), ","),
                  absl::StrJoin(token.used_roles(), ","), ShortTime(token.expires_unix_ns()),
                  StateOf(token), token.by()});
    }
    tokens.Print(env.out);
    if (!response.issued().empty()) {
      Table issued({"CERTIFICATE OF", "SERIAL", "ISSUED", "EXPIRES", "BY"});
      for (const v1::IssuedState& each : response.issued()) {
        issued.Add({each.uri(), each.serial(), ShortTime(each.time_unix_ns()),
                    ShortTime(each.not_after_unix_ns()),
                    each.token().empty() ? "renewal" : absl::StrCat("token ", each.token())});
      }
      issued.Print(env.out);
    }
    if (response.cut()) env.out << "older ones do not fit into one response; name a ROBOT\n";
    return ExitCode::kDone;
  }

 private:
  static std::string StateOf(const v1::TokenState& token) {
    if (token.used_roles_size() >= token.roles_size()) return "used";
    if (token.revoked()) return "revoked";
    return absl::ToUnixNanos(absl::Now()) >= token.expires_unix_ns() ? "expired" : "open";
  }
  static Json TokenJson(const v1::TokenState& token) {
    return {{"id", token.id()},
            {"robot", token.robot()},
            {"host", token.host()},
            {"roles", std::vector<std::string>(token.roles().begin(), token.roles().end())},
            {"used_roles",
             std::vector<std::string>(token.used_roles().begin(), token.used_roles().end())},
            {"by", token.by()},
            {"time", FullTime(token.time_unix_ns())},
            {"expires", FullTime(token.expires_unix_ns())},
            {"state", StateOf(token)}};
  }
  static Json IssuedJson(const v1::IssuedState& each) {
    return {{"uri", each.uri()},
            {"serial", each.serial()},
            {"time", FullTime(each.time_unix_ns())},
            {"not_after", FullTime(each.not_after_unix_ns())},
            {"token", each.token().empty() ? Json(nullptr) : Json(each.token())}};
  }

  std::string robot_;
};

}  // namespace

Commands EnrolCommands() { return MakeCommands<CreateToken, RevokeToken, ListEnrolments>(); }

}  // namespace rips::ripsctl
