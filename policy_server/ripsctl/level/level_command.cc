#include "policy_server/ripsctl/level/level_command.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <ostream>
#include <string>
#include <utility>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/robot_level.h"
#include "services/base/decision_id.h"
#include "services/base/ids.h"

namespace rips::ripsctl {
namespace {

constexpr absl::Duration kWaitMax = absl::Seconds(30);
// Well below the quota of queries, also if a colleague waits, too.
constexpr absl::Duration kWaitPoll = absl::Milliseconds(500);

class LevelCommand : public Command {
 public:
  absl::string_view noun() const final { return "level"; }

 protected:
  std::string robot_;
};

class ShowLevel final : public LevelCommand {
 public:
  absl::string_view verb() const override { return "show"; }
  absl::string_view synopsis() const override {
    return "Show a robot's current level, its possible levels and the last change";
  }
  void AddFlags(CLI::App& app) override { app.add_option("ROBOT", robot_, "Robot id")->required(); }
  ExitCode Run(Env& env) override {
    if (const absl::Status valid = CheckRobot(robot_); !valid.ok()) {
      return UsageError(env, valid.message());
    }
    const auto response = ReadLevel(env, robot_);
    if (!response.ok()) return Failed(env, response.status());
    if (env.json()) {
      PrintJson(ToJson(*response), env.out);
      return ExitCode::kDone;
    }
    const v1::RobotStatus& status = response->status();
    Table table({"robot", EscapeText(status.robot())});
    table.Add({"decided level", status.decided_level()});
    table.Add({"effective level", status.effective_level()});
    table.Add({"stage", status.stage()});
    table.Add({"decision", DecisionIdText(status.decision_id())});
    table.Add({"levels", LevelsText(*response)});
    if (response->has_last()) {
      const v1::Transition& last = response->last();
      table.Add({"last change", absl::StrCat(ShortTime(last.time_unix_ns()), " ", last.from(),
                                             " -> ", last.to(), ", ", last.cause())});
      table.Add({"reason", last.reason()});
      table.Add({"detail", last.detail()});
    }
    table.Print(env.out);
    return ExitCode::kDone;
  }

 private:
  static std::string LevelsText(const v1::GetLevelResponse& response) {
    const auto& soft = response.soft_levels();
    std::vector<std::string> names;
    for (const std::string& name : response.levels()) {
      const bool is_soft = std::find(soft.begin(), soft.end(), name) != soft.end();
      names.push_back(is_soft ? absl::StrCat(name, " (soft)") : name);
    }
    return absl::StrJoin(names, " < ");
  }
};

class LevelHistory final : public LevelCommand {
 public:
  absl::string_view verb() const override { return "history"; }
  absl::string_view synopsis() const override {
    return "List a robot's level changes and refusals, newest first";
  }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id")->required();
    app.add_option("--limit", limit_, "Maximum number of entries")
        ->check(CLI::Range(1, 1000))
        ->capture_default_str();
  }
  ExitCode Run(Env& env) override {
    if (const absl::Status valid = CheckRobot(robot_); !valid.ok()) {
      return UsageError(env, valid.message());
    }
    v1::ListTransitionsRequest request;
    request.set_robot(robot_);
    request.set_limit(limit_);
    const auto response = Call(env, &Stub::ListTransitions, request);
    if (!response.ok()) return Failed(env, response.status());
    if (env.json()) {
      Json list = Json::array();
      for (const v1::Transition& each : response->transitions()) list.push_back(ToJson(each));
      PrintJson({{"transitions", std::move(list)}, {"cut", response->cut()}}, env.out);
      return ExitCode::kDone;
    }
    Table table({"TIME", "FROM", "TO", "MARK", "STAGE", "CAUSE", "ID", "REASON"});
    for (const v1::Transition& each : response->transitions()) {
      const std::string stage =
          each.refused() ? absl::StrCat("refused x", each.count()) : each.stage();
      table.Add({ShortTime(each.time_unix_ns()), each.from(), each.to(),
                 DecisionIdText(each.decision_id()), stage, each.cause(), ShortId(each.id()),
                 each.reason()});
    }
    table.Print(env.out);
    if (response->cut()) env.out << "older transitions do not fit into one answer\n";
    return ExitCode::kDone;
  }

 private:
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
class ChangeLevel : public LevelCommand {
 public:
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id")->required();
    app.add_option("--to", to_, "Target level")->required();
    app.add_option("--reason", reason_, "Reason, recorded with the decision")->required();
    app.add_flag("--dry-run", dry_run_, "Show what would happen; change nothing");
    app.add_flag("--wait", wait_, "Wait until the robot is at the level, for at most 30 s");
  }

 protected:
  // InvalidArgument for flags that the server would refuse.
  absl::Status Fill(v1::LevelRequest* request) const {
    if (absl::Status status = CheckRobot(robot_); !status.ok()) return status;
    if (absl::Status status = CheckReason(reason_); !status.ok()) return status;
    if (!IsUtf8(to_) || to_.empty()) return absl::InvalidArgumentError("--to is not a level name");
    request->set_robot(robot_);
    request->set_to(to_);
    request->set_reason(reason_);
    request->set_dry_run(dry_run_);
    // Repeating a request repeats its answer, so a lost answer does no harm.
    request->set_request_id(absl::HexStringToBytes(NewId()));
    return absl::OkStatus();
  }

  ExitCode Report(Env& env, absl::string_view verb, const v1::LevelRequest& request,
                  const v1::LevelResponse& response) const {
    // Only lowerings need to be seen.
    const bool refused = dry_run_ && !response.blind_because().empty() && !request.accept_blind();
    const bool waits = wait_ && !dry_run_;
    if (!env.json()) PrintReport(env, verb, refused, response);
    std::optional<Awaited> awaited;
    if (waits) awaited = AwaitReached(env, response);
    if (env.json()) {
      PrintJsonReport(env, verb, request, response, awaited);
    } else if (waits && awaited->reached) {
      env.out << robot_ << " is at " << EscapeText(awaited->level)
              << (awaited->level == response.decided_level() ? "" : ", above the level decided")
              << ": every actuator has read it back\n";
    } else if (waits) {
      env.out << robot_ << " is not at " << EscapeText(response.decided_level()) << ": "
              << EscapeText(awaited->why) << "\n";
    }
    const bool missed = waits && !awaited->reached;
    return refused || missed ? ExitCode::kRefused : ExitCode::kDone;
  }

  void PrintReport(Env& env, absl::string_view verb, bool refused,
                   const v1::LevelResponse& response) const {
    if (dry_run_) {
      if (!refused)
        env.out << "would " << verb << " " << robot_ << " to " << EscapeText(to_) << "; ";
      env.out << "nothing was changed\n";
    } else {
      env.out << robot_ << " goes to " << EscapeText(response.decided_level()) << " ("
              << DecisionIdText(response.decision_id()) << ")\n";
    }
    if (verb == "raise" && response.soft()) {
      env.out << EscapeText(response.decided_level())
              << " is a soft level: a rule may lower it again, as soon as what it asks is true\n";
    }
    if (dry_run_ && verb == "lower") {
      PrintDryRun(robot_, response, refused, "", env.out);
    } else {
      for (const std::string& why : response.blind_because()) {
        env.out << "blind: " << EscapeText(why) << "\n";
      }
      for (const std::string& rule : response.would_raise_again()) {
        env.out << "may be raised again by rule " << EscapeText(rule) << "\n";
      }
    }
    if (wait_ && !dry_run_) {
      env.out << "waiting until it is there, for at most " << absl::FormatDuration(kWaitMax)
              << "; Ctrl-C ends the waiting, not the decision" << std::endl;
    }
  }

  // What --wait came to; `why` if the robot is not there.
  struct Awaited {
    bool reached = false;
    std::string level;  // that the actuators hold; may be above the one decided
    std::string why;
  };

  // The level that was decided is one thing, and where the robot is another. The server tries again
  // what failed, so that only the time ends the wait.
  Awaited AwaitReached(Env& env, const v1::LevelResponse& response) const {
    const absl::Time end = absl::Now() + kWaitMax;
    std::string why;
    do {
      const auto seen = ReadLevel(env, robot_);
      if (seen.ok()) {
        const v1::RobotStatus& status = seen->status();
        if (DecisionIdText(status.decision_id()) != DecisionIdText(response.decision_id())) {
          return {.why =
                      absl::StrCat("the level was decided anew meanwhile: ", status.decided_level(),
                                   " (", DecisionIdText(status.decision_id()), ")",
                                   seen->has_last() ? ", " : "", seen->last().cause())};
        }
        if (status.stage() == "verified") {
          return {.reached = true, .level = status.effective_level()};
        }
        why = absl::StrCat(status.stage(), status.degraded().empty() ? "" : ": ",
                           absl::StrJoin(status.degraded(), "; "));
      } else {
        why = std::string(seen.status().message());
        const absl::Status& status = seen.status();
        const bool passes = absl::IsUnavailable(status) || absl::IsDeadlineExceeded(status) ||
                            absl::IsResourceExhausted(status);
        if (!passes) return {.why = why};
      }
      absl::SleepFor(kWaitPoll);
    } while (absl::Now() < end);
    return {.why = absl::StrCat("not read back in ", absl::FormatDuration(kWaitMax), "; ", why,
                                "; the decision stands, and is tried again")};
  }

  static void PrintJsonReport(Env& env, absl::string_view verb, const v1::LevelRequest& request,
                              const v1::LevelResponse& response,
                              const std::optional<Awaited>& awaited) {
    Json json = {{"robot", request.robot()},
                 {"to", request.to()},
                 {"dry_run", request.dry_run()},
                 {"decided_level", response.decided_level()},
                 {"soft", response.soft()}};
    json["decision_id"] =
        response.has_decision_id() ? Json(DecisionIdText(response.decision_id())) : Json(nullptr);
    if (!request.expected_level().empty()) {
      json["expected"] = absl::StrCat(request.expected_level(), "@",
                                      DecisionIdText(request.expected_decision_id()));
    }
    json["would_raise_again"] = Json::array();
    for (const auto& rule : response.would_raise_again()) json["would_raise_again"].push_back(rule);
    if (request.dry_run() && verb == "lower") json["not_tried"] = NotTried();
    json["blind_because"] = Json::array();
    for (const auto& why : response.blind_because()) json["blind_because"].push_back(why);
    if (awaited.has_value()) json["reached"] = awaited->reached;
    if (awaited.has_value() && awaited->reached) json["effective_level"] = awaited->level;
    if (awaited.has_value() && !awaited->reached) json["not_reached_because"] = awaited->why;
    PrintJson(json, env.out);
  }

 private:
  std::string to_;
  std::string reason_;
  bool dry_run_ = false;
  bool wait_ = false;
};

class RaiseLevel final : public ChangeLevel {
 public:
  absl::string_view verb() const override { return "raise"; }
  absl::string_view synopsis() const override {
    return "Raise a robot to a more restrictive level";
  }
  ExitCode Run(Env& env) override {
    v1::LevelRequest request;
    if (const absl::Status valid = Fill(&request); !valid.ok()) {
      return UsageError(env, valid.message());
    }
    const auto response = Call(env, &Stub::Raise, request);
    if (!response.ok()) return Failed(env, response.status());
    return Report(env, "raise", request, *response);
  }
};

class LowerLevel final : public ChangeLevel {
 public:
  absl::string_view verb() const override { return "lower"; }
  absl::string_view synopsis() const override {
    return "Lower a robot to a less restrictive level";
  }
  void AddFlags(CLI::App& app) override {
    ChangeLevel::AddFlags(app);
    app.add_option("--expect", expect_,
                   "LEVEL@TERM.EPOCH the robot must be at; default: read, shown and sent");
    app.add_flag("--accept-blind", accept_blind_,
                 "Lower even if the server does not see the robot now");
  }
  ExitCode Run(Env& env) override {
    v1::LevelRequest request;
    absl::Status valid = Fill(&request);
    if (valid.ok() && !expect_.empty()) valid = ParseExpected(expect_, &request);
    if (!valid.ok()) return UsageError(env, valid.message());
    request.set_accept_blind(accept_blind_);
    if (expect_.empty()) {
      const auto seen = ReadLevel(env, robot_);
      if (!seen.ok()) return Failed(env, seen.status());
      Show(env, *seen);
      request.set_expected_level(seen->status().decided_level());
      *request.mutable_expected_decision_id() = seen->status().decision_id();
    }
    const auto response = Call(env, &Stub::DeEscalate, request);
    if (!response.ok()) return Failed(env, response.status());
    return Report(env, "lower", request, *response);
  }

 private:
  // On the error stream when the output is for programs.
  void Show(Env& env, const v1::GetLevelResponse& seen) const {
    std::ostream& out = env.json() ? env.err : env.out;
    out << robot_ << " is at " << EscapeText(seen.status().decided_level()) << " ("
        << DecisionIdText(seen.status().decision_id()) << ")";
    if (seen.has_last()) {
      out << " since " << ShortTime(seen.last().time_unix_ns()) << ", "
          << EscapeText(seen.last().cause());
    }
    out << "\n";
  }

  std::string expect_;
  bool accept_blind_ = false;
};

}  // namespace

Commands LevelCommands() {
  Commands commands;
  commands.push_back(std::make_unique<ShowLevel>());
  commands.push_back(std::make_unique<LevelHistory>());
  commands.push_back(std::make_unique<RaiseLevel>());
  commands.push_back(std::make_unique<LowerLevel>());
  return commands;
}

}  // namespace rips::ripsctl
