// `ripsctl level approve`: the second operator's word.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "policy_server/ripsctl/cli/firewalls.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/robot_level.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/level/await_level.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

constexpr size_t kIdDigitsLeast = 6;
constexpr size_t kIdDigitsMost = 32;

class ApproveLevel final : public RobotCommand {
 public:
  ApproveLevel()
      : RobotCommand({"level", "approve",
                      "Approve or reject another operator's request to lower a robot"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("ID", id_,
                   "Request id, or its first 6 or more digits, as `ripsctl level show` prints it")
        ->required();
    app.add_option("--reason", reason_, "Reason, recorded with the decision")->required();
    app.add_flag("--reject", reject_, "Reject the request; the level stays as it is");
    app.add_flag("--accept-blind", accept_blind_,
                 "Lower even if the server does not see all of the robot; the request must say "
                 "so, too");
    app.add_flag("--accept-changes", accept_changes_,
                 "Lower even if nodes or topics have come or gone since the request");
    app.add_flag("--wait", wait_, "Wait until the robot is at the level, for at most 30 s");
  }
  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(RobotCommand::Check());
    RIPS_RETURN_IF_ERROR(CheckReason(reason_));
    if (reject_ && (accept_blind_ || accept_changes_ || wait_)) {
      return absl::InvalidArgumentError(
          "--reject goes with none of --accept-blind, --accept-changes and --wait");
    }
    bool hex = id_.size() >= kIdDigitsLeast && id_.size() <= kIdDigitsMost;
    for (const char c : id_) hex = hex && absl::ascii_isxdigit(static_cast<unsigned char>(c));
    if (hex) return absl::OkStatus();
    return absl::InvalidArgumentError(
        absl::StrCat("`", absl::CHexEscape(id_), "` is not an id: ", kIdDigitsLeast, " to ",
                     kIdDigitsMost, " hexadecimal digits, as `ripsctl level show` prints them"));
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    RIPS_ASSIGN_OR_RETURN(const v1::GetLevelResponse seen, ReadLevel(env, robot_));
    RIPS_ASSIGN_OR_RETURN(const v1::PendingApproval pending, Find(seen));
    if (!env.json()) {
      env.out << EscapeText(PendingText(robot_, pending)) << "\n";
      for (const std::string& why : seen.status().degraded()) {
        env.out << "now: " << EscapeText(why) << "\n";
      }
      if (!reject_) {
        firewalls_ = ReadFirewalls(env, robot_, seen);
        PrintFirewalls(*firewalls_, env.out);
      }
    }
    v1::ApproveRequest request;
    request.set_robot(robot_);
    request.set_pending_approval_id(pending.id());
    request.set_reason(reason_);
    request.set_reject(reject_);
    request.set_accept_blind(accept_blind_);
    request.set_accept_changes(accept_changes_);
    request.set_request_id(absl::HexStringToBytes(NewId()));
    RIPS_ASSIGN_OR_RETURN(const v1::LevelResponse response, Call(env, &Stub::Approve, request));
    return Report(env, pending, response);
  }

 private:
  // What is approved is what was shown: the whole id goes to the server.
  absl::StatusOr<v1::PendingApproval> Find(const v1::GetLevelResponse& seen) const {
    std::optional<v1::PendingApproval> found;
    for (const v1::PendingApproval& each : seen.pending_approvals()) {
      if (!absl::StartsWith(each.id(), absl::AsciiStrToLower(id_))) continue;
      if (found.has_value()) {
        return absl::InvalidArgumentError(
            absl::StrCat("`", id_, "` begins the ids of several; write more digits"));
      }
      found = each;
    }
    if (found.has_value()) return *std::move(found);
    std::string waiting;
    for (const v1::PendingApproval& each : seen.pending_approvals()) {
      absl::StrAppend(&waiting, "; this one does: ", PendingText(robot_, each));
    }
    return absl::NotFoundError(absl::StrCat(
        "no lowering of ", robot_, " waits under `", id_, "`",
        waiting.empty() ? absl::StrCat(", nor any other; if one did, `ripsctl alert list ", robot_,
                                       "` says why it does no more, unless the server restarted")
                        : waiting));
  }

  ExitCode Report(Env& env, const v1::PendingApproval& pending,
                  const v1::LevelResponse& response) const {
    std::optional<Awaited> awaited;
    if (!env.json()) {
      if (reject_) {
        env.out << robot_ << " stays at " << EscapeText(response.decided_level()) << "\n";
      } else {
        env.out << robot_ << " goes to " << EscapeText(response.decided_level()) << " ("
                << DecisionIdText(response.decision_id()) << ")\n";
        PrintWarnings(response, env.out);
      }
    }
    if (wait_) awaited = AwaitReached(env, robot_, response);
    if (env.json()) {
      Json json = {{"robot", robot_},
                   {"id", pending.id()},
                   {"from", pending.from()},
                   {"to", pending.to()},
                   {"operator", pending.operator_()},
                   {"reason", pending.reason()},
                   {"rejected", reject_},
                   {"decided_level", response.decided_level()},
                   {"decision_id", DecisionIdText(response.decision_id())},
                   {"would_raise_again", JsonList(response.would_raise_again())},
                   {"blind_because", JsonList(response.blind_because())}};
      if (awaited.has_value()) AddAwaited(*awaited, json);
      PrintJson(json, env.out);
    } else if (awaited.has_value()) {
      PrintAwaited(env, robot_, response, *awaited);
      if (awaited->reached && firewalls_.has_value()) PrintReleased(env, robot_, *firewalls_);
    }
    return awaited.has_value() && !awaited->reached ? ExitCode::kRefused : ExitCode::kDone;
  }

  std::string id_;
  std::string reason_;
  bool reject_ = false;
  bool accept_blind_ = false;
  bool accept_changes_ = false;
  bool wait_ = false;
  std::optional<absl::StatusOr<std::vector<FirewallOfHost>>> firewalls_;  // before; text only
};

}  // namespace

Commands ApproveCommands() { return MakeCommands<ApproveLevel>(); }

}  // namespace rips::ripsctl
