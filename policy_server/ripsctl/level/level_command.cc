// `ripsctl level`: show, history, raise, lower.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/ripsctl/cli/firewalls.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/robot_level.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/explain/findings_view.h"
#include "policy_server/ripsctl/level/await_level.h"
#include "services/base/decision_id.h"
#include "services/base/ids.h"
#include "services/base/status_macros.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
namespace {

class ShowLevel final : public RobotCommand {
 public:
  ShowLevel()
      : RobotCommand({"level", "show",
                      "Show a robot's current level, its possible levels and the last change"}) {}
  absl::StatusOr<ExitCode> Run(Env& env) override {
    RIPS_ASSIGN_OR_RETURN(const auto response, ReadLevel(env, robot_, /*lowering_rules=*/true));
    const auto firewalls = ReadFirewalls(env, robot_, response);
    if (env.json()) {
      Json json = ToJson(response);
      json["firewalls"] = FirewallsJson(firewalls);
      return PrintJson(env, json);
    }
    Table table = StatusTable(response.status());
    table.Add({"levels", LevelsText(response)});
    if (const std::string text = LoweringByRulesText(response); !text.empty()) {
      table.Add({"rules", text});
    }
    for (const v1::LoweringRule& rule : response.lowering_rules()) {
      table.Add({"to lower it",
                 absl::StrCat(rule.rule(), ", ", rule.evidence().place(), ": ", HoldsText(rule))});
    }
    if (response.has_last()) {
      const v1::Transition& last = response.last();
      table.Add({"last change", absl::StrCat(ShortTime(last.time_unix_ns()), " ", last.from(),
                                             " -> ", last.to(), ", ", last.cause())});
      table.Add({"reason", last.reason()});
      table.Add({"detail", last.detail()});
    }
    for (const v1::PendingApproval& each : response.pending_approvals()) {
      table.Add({"to approve", PendingText(robot_, each)});
    }
    table.Print(env.out);
    PrintFirewalls(firewalls, env.out);
    return ExitCode::kDone;
  }

 private:
  static std::string LevelsText(const v1::GetLevelResponse& response) {
    const auto& soft = response.soft_levels();
    std::vector<std::string> names;
    for (const std::string& name : response.levels()) {
      const bool is_soft = std::find(soft.begin(), soft.end(), name) != soft.end();
      const auto& two_person = response.two_person_levels();
      const bool two = std::find(two_person.begin(), two_person.end(), name) != two_person.end();
      names.push_back(absl::StrCat(name, is_soft ? " (soft)" : "", two ? " (two persons)" : ""));
    }
    return absl::StrJoin(names, " < ");
  }
};

class LevelHistory final : public RobotCommand {
 public:
  LevelHistory()
      : RobotCommand(
            {"level", "history", "List a robot's level changes and refusals, newest first"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("--limit", limit_, "Maximum number of entries")
        ->check(CLI::Range(1, 1000))
        ->capture_default_str();
    app.footer(absl::StrCat(
        "A rejected request to lower the robot is no change, and is not listed: `ripsctl alert\n"
        "list ROBOT` has its alert, `ripsctl audit tail` on the server both its records.\n\n",
        app.get_footer()));
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::ListTransitionsRequest request;
    request.set_robot(robot_);
    request.set_limit(limit_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ListTransitions, request));
    if (env.json()) {
      return PrintJson(
          env, {{"transitions", JsonList(response.transitions())}, {"cut", response.cut()}});
    }
    Print(response, env);
    if (response.cut()) env.out << "older transitions do not fit into one response\n";
    return ExitCode::kDone;
  }

 private:
  // Two lines for each, the second one wrapped: a cause with its certificate and a reason are long.
  static void Print(const v1::ListTransitionsResponse& response, Env& env) {
    constexpr absl::string_view kMargin = "    ";
    const size_t columns = TerminalColumns(env.terminal.out);
    Table table({"TIME", "FROM", "TO", "DECISION", "STAGE"});
    std::vector<std::string> details = {"ID        CAUSE: REASON"};
    for (const v1::Transition& each : response.transitions()) {
      const std::string stage =
          each.refused() ? absl::StrCat("refused x", each.count()) : each.stage();
      table.Add({ShortTime(each.time_unix_ns()), each.from(), each.to(),
                 DecisionIdText(each.decision_id()), stage});
      details.push_back(absl::StrCat(ShortId(each.id()), "  ", each.cause(),
                                     each.reason().empty() ? "" : ": ", each.reason()));
    }
    const std::vector<std::string> lines = table.Lines();
    for (size_t i = 0; i < lines.size(); ++i) {
      env.out << lines[i] << "\n";
      PrintWrapped(details[i], kMargin, columns, env.out);
    }
  }

  uint32_t limit_ = 100;
};

// `LEVEL@TERM.EPOCH`
absl::Status ParseExpected(const std::string& text, v1::LevelRequest* request) {
  const size_t at = text.rfind('@');
  const absl::StatusOr<DecisionId> decision_id =
      at == std::string::npos || at == 0 ? absl::InvalidArgumentError("")
                                         : ParseDecisionId(absl::string_view(text).substr(at + 1));
  if (!decision_id.ok()) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--expect is `", text, "`; write LEVEL@TERM.EPOCH, for example COMPROMISED@3.17"));
  }
  request->set_expected_level(text.substr(0, at));
  request->mutable_expected_decision_id()->set_term(decision_id->term);
  request->mutable_expected_decision_id()->set_epoch(decision_id->epoch);
  return absl::OkStatus();
}

// What raise and lower share.
class ChangeLevel : public RobotCommand {
 public:
  using RobotCommand::RobotCommand;
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("--to", to_, "Target level")->required();
    app.add_option("--reason", reason_,
                   "Reason, recorded with the decision; required unless --dry-run");
    app.add_flag("--dry-run", dry_run_, "Show what would happen; change nothing");
    app.add_flag("--wait", wait_, "Wait until the robot is at the level, for at most 30 s");
  }

  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(RobotCommand::Check());
    if (dry_run_ && reason_.empty()) reason_ = "dry run";
    RIPS_RETURN_IF_ERROR(CheckReason(reason_));
    if (to_.empty() || FindInvalidUtf8(to_)) {
      return absl::InvalidArgumentError("--to is not a level name");
    }
    request_.set_robot(robot_);
    request_.set_to(to_);
    request_.set_reason(reason_);
    request_.set_dry_run(dry_run_);
    // Repeating a request repeats its answer, so a lost answer does no harm.
    request_.set_request_id(absl::HexStringToBytes(NewId()));
    return absl::OkStatus();
  }

 protected:
  ExitCode Report(Env& env, const v1::LevelResponse& response) const {
    // Only lowerings need to be seen.
    const bool refused = dry_run_ && !response.blind_because().empty() && !request_.accept_blind();
    const bool pending = !dry_run_ && response.needs_approval();
    if (!env.json() && pending) {
      PrintPending(env, response);
    } else if (!env.json()) {
      PrintReport(env, refused, response);
    }
    std::optional<Awaited> awaited;
    if (wait_ && !dry_run_ && !pending) awaited = AwaitReached(env, robot_, response);
    if (env.json()) {
      PrintJsonReport(env, response, awaited);
    } else if (awaited.has_value()) {
      PrintAwaited(env, robot_, response, *awaited);
      if (awaited->reached && firewalls_.has_value()) PrintReleased(env, robot_, *firewalls_);
    }
    const bool missed = awaited.has_value() && !awaited->reached;
    // What waits is not done: a script must not go on as if it were.
    return refused || missed || pending ? ExitCode::kRefused : ExitCode::kDone;
  }

  void PrintPending(Env& env, const v1::LevelResponse& response) const {
    env.out << robot_ << " stays at " << EscapeText(response.decided_level())
            << " until a second operator approves the lowering, before "
            << ShortTime(response.approval_expires_unix_ns()) << ", with\n  ripsctl level approve "
            << robot_ << " " << ShellWord(ShortId(response.pending_approval_id()))
            << " --reason TEXT --wait" << (request_.accept_blind() ? " --accept-blind" : "") << "\n"
            << "it must be asked for again if the level, the rules or what they judge change "
               "before that, or the server restarts\n";
    PrintWarnings(response, env.out);
  }

  void PrintReport(Env& env, bool refused, const v1::LevelResponse& response) const {
    const std::string& verb = info().verb;
    if (dry_run_) {
      if (!refused)
        env.out << "would " << verb << " " << robot_ << " to " << EscapeText(to_) << "; ";
      env.out << "nothing was changed\n";
    } else {
      env.out << robot_ << " goes to " << EscapeText(response.decided_level()) << " ("
              << DecisionIdText(response.decision_id()) << ")\n";
    }
    if (response.soft()) {
      env.out << EscapeText(response.decided_level())
              << " is a soft level: a rule may lower it again as soon as its condition holds\n";
    }
    if (dry_run_ && verb == "lower") {
      PrintDryRun(robot_, response, refused, "", env.out);
    } else {
      PrintWarnings(response, env.out);
    }
  }

  void PrintJsonReport(Env& env, const v1::LevelResponse& response,
                       const std::optional<Awaited>& awaited) const {
    Json json = {{"robot", robot_},
                 {"to", to_},
                 {"dry_run", dry_run_},
                 {"decided_level", response.decided_level()},
                 {"soft", response.soft()}};
    json["decision_id"] =
        response.has_decision_id() ? Json(DecisionIdText(response.decision_id())) : Json(nullptr);
    if (!request_.expected_level().empty()) {
      json["expected"] = absl::StrCat(request_.expected_level(), "@",
                                      DecisionIdText(request_.expected_decision_id()));
    }
    json["would_raise_again"] = JsonList(response.would_raise_again());
    if (dry_run_ && info().verb == "lower") json["not_tried"] = NotTried();
    json["blind_because"] = JsonList(response.blind_because());
    if (info().verb == "lower") json["needs_approval"] = response.needs_approval();
    if (!response.pending_approval_id().empty()) {
      json["pending_approval_id"] = response.pending_approval_id();
      json["approval_expires"] = FullTime(response.approval_expires_unix_ns());
    }
    if (firewalls_.has_value()) json["firewalls"] = FirewallsJson(*firewalls_);
    if (awaited.has_value()) AddAwaited(*awaited, json);
    PrintJson(json, env.out);
  }

  // Set by Check.
  v1::LevelRequest request_;
  // As shown before the call; unset if nothing was.
  std::optional<absl::StatusOr<std::vector<FirewallOfHost>>> firewalls_;

 private:
  std::string to_;
  std::string reason_;
  bool dry_run_ = false;
  bool wait_ = false;
};

class RaiseLevel final : public ChangeLevel {
 public:
  RaiseLevel() : ChangeLevel({"level", "raise", "Raise a robot to a more restrictive level"}) {}
  absl::StatusOr<ExitCode> Run(Env& env) override {
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::Raise, request_));
    return Report(env, response);
  }
};

class LowerLevel final : public ChangeLevel {
 public:
  LowerLevel() : ChangeLevel({"level", "lower", "Lower a robot to a less restrictive level"}) {}
  void AddFlags(CLI::App& app) override {
    ChangeLevel::AddFlags(app);
    app.add_option("--expect", expect_,
                   "LEVEL@TERM.EPOCH that the robot must be at; default: the current one");
    app.add_flag("--accept-blind", accept_blind_,
                 "Lower even if the server does not see all of the robot");
  }
  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(ChangeLevel::Check());
    request_.set_accept_blind(accept_blind_);
    return expect_.empty() ? absl::OkStatus() : ParseExpected(expect_, &request_);
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    if (expect_.empty()) {
      RIPS_ASSIGN_OR_RETURN(const auto seen, ReadLevel(env, robot_));
      Show(env, seen);
      request_.set_expected_level(seen.status().decided_level());
      *request_.mutable_expected_decision_id() = seen.status().decision_id();
    }
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::DeEscalate, request_));
    const ExitCode code = Report(env, response);
    if (request_.dry_run() && !env.json()) ShowFindings(env);
    return code;
  }

 private:
  // No rule need ask for them; who lowers should know.
  void ShowFindings(Env& env) const {
    v1::GetCoverageRequest request;
    request.set_robot(robot_);
    request.set_findings_only(true);
    PrintFindingsNow(robot_, Call(env, &Stub::GetCoverage, request), env.out);
  }

  // On the error stream when the output is for programs.
  void Show(Env& env, const v1::GetLevelResponse& seen) {
    TextStream out = env.json() ? env.err : env.out;
    out << robot_ << " is at " << EscapeText(seen.status().decided_level()) << " ("
        << DecisionIdText(seen.status().decision_id()) << ")";
    if (seen.has_last()) {
      out << " since " << ShortTime(seen.last().time_unix_ns()) << ", "
          << EscapeText(seen.last().cause());
    }
    out << "\n";
    firewalls_ = ReadFirewalls(env, robot_, seen);
    PrintFirewalls(*firewalls_, out);
  }

  std::string expect_;
  bool accept_blind_ = false;
};

}  // namespace

Commands LevelCommands() { return MakeCommands<ShowLevel, LevelHistory, RaiseLevel, LowerLevel>(); }

}  // namespace rips::ripsctl
