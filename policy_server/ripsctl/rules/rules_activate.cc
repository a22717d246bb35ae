// `ripsctl rules activate`, `rollback` and `stop`: which bundle judges which robots. JSON:
// {"dry_run","rollout":{..} or null,"changed":[..],"left_out":[..],"notes":[..]}; of `stop` {"rollout":{..}}.
// The roll-out as ToJson in rollout_text.h; with --wait, as it is at its end.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "policy_server/policy/bundle/inventory.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/rules/await_rollout.h"
#include "policy_server/ripsctl/rules/robot_selection_flags.h"
#include "policy_server/ripsctl/rules/rollout_text.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_reader.h"

namespace rips::ripsctl {
namespace {

constexpr absl::Duration kSoakMin = absl::Seconds(1);
constexpr absl::Duration kSoakMax = absl::Hours(7 * 24);
constexpr int kAlertsMax = 1'000;
constexpr size_t kStagesMax = 32;

// `ring=canary` or `10%`.
absl::StatusOr<v1::RolloutStage> ParseStage(const std::string& text) {
  v1::RolloutStage stage;
  absl::string_view percent = text;
  if (absl::ConsumeSuffix(&percent, "%")) {
    uint32_t value = 0;
    if (!absl::SimpleAtoi(percent, &value) || value < 1 || value > 100) {
      return absl::InvalidArgumentError(
          absl::StrCat("--stage is `", text, "`; a percentage is from 1% to 100%"));
    }
    stage.set_percent(value);
    return stage;
  }
  if (!bundle::ParseLabel(text).ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat("--stage is `", text,
                     "`; write KEY=VALUE for the robots with that label, for example "
                     "`ring=canary`, or a percentage, for example `10%`"));
  }
  stage.set_label(text);
  return stage;
}

// Also `10m`.
absl::StatusOr<absl::Duration> ParseSoak(const std::string& text) {
  const auto parsed = ParseConfigDuration(absl::EndsWith(text, "m") ? text + "in" : text);
  if (!parsed.ok() || *parsed < kSoakMin || *parsed > kSoakMax) {
    return absl::InvalidArgumentError(absl::StrCat(
        "--soak is `", text, "`; write a time from 1s to 7d, for example `10m` or `2h`"));
  }
  return *parsed;
}

Json ResponseJson(const v1::RolloutResponse& response, bool dry_run) {
  return {{"dry_run", dry_run},
          {"rollout", ToJson(response.rollout())},
          {"changed", JsonList(response.changed())},
          {"left_out", JsonList(response.left_out())},
          {"notes", JsonList(response.notes())}};
}

void PrintLeftOut(const v1::RolloutResponse& response, TextStream out) {
  for (const std::string& text : response.left_out()) {
    out << "left out  " << EscapeText(text) << "\n";
  }
  for (const std::string& text : response.notes()) out << "note      " << EscapeText(text) << "\n";
}

class ActivateRulesCommand final : public Command {
 public:
  ActivateRulesCommand()
      : Command({"rules", "activate",
                 "Have robots judged by a bundle that the server keeps, stage by stage"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("BUNDLE", bundle_,
                   "Id or its first 8 or more digits, as `rules list` shows them, or `directory`: "
                   "what the server's directory of bundles holds")
        ->required();
    robots_.AddFlags(app, "All robots whose policy has the bundle's name");
    app.add_option("--stage", stages_,
                   "Stages in order, each KEY=VALUE (robots with that label) or N% (the first ones "
                   "by name); default: all robots at once");
    app.add_option("--soak", soak_, "Time for which a stage must be healthy, 1s to 7d")
        ->capture_default_str();
    app.add_option("--alerts-max", alerts_max_,
                   "Stop at more alerts of rules, of severity medium or above, on one robot within "
                   "a minute")
        ->check(CLI::Range(1, kAlertsMax))
        ->capture_default_str();
    app.add_flag("--rollback", roll_back_, "If it stops by itself, take its robots back");
    app.add_option("--reason", reason_, "Reason, recorded by the server")->required();
    app.add_flag("--dry-run", dry_run_, "Only show what would happen");
    app.add_flag("--wait", wait_, "Follow the roll-out until it is done, or exit with 1");
  }

  absl::Status Check() override {
    if (bundle_ != kDirectoryBundle) RIPS_RETURN_IF_ERROR(CheckBundleId(bundle_));
    RIPS_RETURN_IF_ERROR(robots_.Check());
    RIPS_RETURN_IF_ERROR(CheckReason(reason_));
    if (stages_.size() > kStagesMax) {
      return absl::InvalidArgumentError(
          absl::StrCat("there are more than ", kStagesMax, " stages"));
    }
    if (dry_run_ && wait_) {
      return absl::InvalidArgumentError("--dry-run begins nothing that --wait could follow");
    }
    for (const std::string& text : stages_) {
      RIPS_ASSIGN_OR_RETURN(*request_.add_stages(), ParseStage(text));
    }
    RIPS_ASSIGN_OR_RETURN(const absl::Duration soak, ParseSoak(soak_));
    request_.set_soak_ms(static_cast<uint64_t>(absl::ToInt64Milliseconds(soak)));
    return absl::OkStatus();
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    request_.set_bundle_id(bundle_);
    *request_.mutable_robots() = robots_.ToProto();
    request_.set_alerts_per_minute_max(alerts_max_);
    request_.set_roll_back_when_stopped(roll_back_);
    request_.set_reason(reason_);
    request_.set_dry_run(dry_run_);
    RIPS_ASSIGN_OR_RETURN(v1::RolloutResponse response, Call(env, &Stub::ActivateBundle, request_));
    if (!env.json()) Print(env, response);
    // Nothing began if every robot was left out.
    const bool wait = wait_ && !response.changed().empty();
    if (wait) {
      RIPS_ASSIGN_OR_RETURN(*response.mutable_rollout(), AwaitRollout(env, response.rollout()));
    }
    if (env.json()) PrintJson(ResponseJson(response, dry_run_), env.out);
    if (!wait || response.rollout().state() == "done") return ExitCode::kDone;
    if (!env.json() && roll_back_) env.out << "what judges its robots now  ripsctl rules status\n";
    if (!env.json() && !roll_back_) PrintHowToGoBack(env);
    return ExitCode::kRefused;
  }

 private:
  void Print(Env& env, const v1::RolloutResponse& response) const {
    if (response.changed().empty()) {
      env.out << "nothing changes\n";
      return PrintLeftOut(response, env.out);
    }
    const v1::Rollout& rollout = response.rollout();
    env.out << (dry_run_ ? "nothing was changed; it would be: " : "")
            << EscapeText(absl::StrCat(ShortBundle(rollout.bundle_id()), " `", rollout.name(), "` ",
                                       dry_run_ ? "would first judge " : "is first to judge ",
                                       NamedRobots(response.changed())))
            << "\n";
    PrintStages(rollout, env.out);
    PrintLeftOut(response, env.out);
    env.out << EscapeText(RolloutLimits(rollout)) << "\n";
    if (dry_run_) return;
    env.out << "follow it  ripsctl rules status\n"
            << "stop it    ripsctl rules stop --reason TEXT\n";
    PrintHowToGoBack(env);
  }
  void PrintHowToGoBack(Env& env) const {
    env.out << "go back    ripsctl rules rollback " << robots_.ToFlags() << " --reason TEXT"
            << std::endl;
  }

  std::string bundle_;
  RobotSelectionFlags robots_;
  std::vector<std::string> stages_;
  std::string soak_ = "10min";
  uint32_t alerts_max_ = 10;
  bool roll_back_ = false;
  std::string reason_;
  bool dry_run_ = false;
  bool wait_ = false;
  v1::ActivateBundleRequest request_;
};

class RollBackRulesCommand final : public Command {
 public:
  RollBackRulesCommand()
      : Command({"rules", "rollback",
                 "Have robots judged again by what judged them before; stops their roll-out"}) {}
  void AddFlags(CLI::App& app) override {
    robots_.AddFlags(app, "All robots of the inventory");
    app.add_option("--reason", reason_, "Reason, recorded by the server")->required();
    app.add_flag("--dry-run", dry_run_, "Only show what would happen");
  }
  absl::Status Check() override {
    RIPS_RETURN_IF_ERROR(robots_.Check());
    return CheckReason(reason_);
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::RollBackBundleRequest request;
    *request.mutable_robots() = robots_.ToProto();
    request.set_reason(reason_);
    request.set_dry_run(dry_run_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::RollBackBundle, request));
    const bool changed = !response.changed().empty();
    if (env.json()) {
      PrintJson(ResponseJson(response, dry_run_), env.out);
    } else {
      Print(env, response);
    }
    return changed ? ExitCode::kDone : ExitCode::kRefused;
  }

 private:
  void Print(Env& env, const v1::RolloutResponse& response) const {
    if (response.changed().empty()) {
      env.out << "nothing changes: no robot has anything to go back to\n";
    } else {
      env.out << (dry_run_ ? "nothing was changed; would be judged as before: "
                           : "judged as before from now on: ")
              << EscapeText(NamedRobots(response.changed())) << "\n";
    }
    PrintLeftOut(response, env.out);
    const v1::Rollout& rollout = response.rollout();
    if (rollout.id().empty() || dry_run_) return;
    env.out << "newest roll-out "
            << EscapeText(absl::StrCat(ShortBundle(rollout.bundle_id()), ": ",
                                       RolloutState(rollout, absl::GetCurrentTimeNanos())))
            << "\n";
  }

  RobotSelectionFlags robots_;
  std::string reason_;
  bool dry_run_ = false;
};

class StopRolloutCommand final : public Command {
 public:
  StopRolloutCommand()
      : Command({"rules", "stop", "Stop the roll-out; robots stay judged as they are"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("--reason", reason_, "Reason, recorded by the server")->required();
  }
  absl::Status Check() override { return CheckReason(reason_); }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::StopRolloutRequest request;
    request.set_reason(reason_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::StopRollout, request));
    if (env.json()) return PrintJson(env, {{"rollout", ToJson(response.rollout())}});
    PrintRollout(response.rollout(), absl::GetCurrentTimeNanos(), env.out);
    env.out << "robots stay judged as they are: `ripsctl rules status` shows it, `ripsctl rules "
               "rollback` takes them back\n";
    return ExitCode::kDone;
  }

 private:
  std::string reason_;
};

}  // namespace

Commands ActivateRules() {
  return MakeCommands<ActivateRulesCommand, RollBackRulesCommand, StopRolloutCommand>();
}

}  // namespace rips::ripsctl
