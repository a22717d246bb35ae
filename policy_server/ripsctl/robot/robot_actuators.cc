// `ripsctl robot receipts` and `ripsctl robot drill`: what a robot's actuators answered, and
// whether they could carry out its levels. `drill` exits with 0 if every actuator has answered and
// every step works, else with 1.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
namespace {

// Of what a program printed, shown to people: the last lines.
constexpr size_t kOutputLinesShown = 10;
// A drill is answered within 30 s; whatever --timeout says, it is waited for.
constexpr absl::Duration kDrillTimeout = absl::Seconds(35);

std::string StageName(v1::Receipt::Stage stage) {
  return EnumText(v1::Receipt::Stage_Name(stage), "", "none");
}

const char* DrilledName(v1::StepResult::Drilled drilled) {
  switch (drilled) {
    case v1::StepResult::DRILLED_UNSPECIFIED:
      return "no_drill";
    case v1::StepResult::DRILLED_DONE:
      return "drilled";
    case v1::StepResult::DRILLED_LOOKED:
      return "looked";
    default:
      return "not_tried";
  }
}

using Steps = google::protobuf::RepeatedPtrField<v1::StepResult>;

// Those that failed first, else as they came.
std::vector<const v1::StepResult*> FailedFirst(const Steps& steps) {
  std::vector<const v1::StepResult*> sorted;
  for (const v1::StepResult& step : steps) sorted.push_back(&step);
  std::stable_partition(sorted.begin(), sorted.end(),
                        [](const v1::StepResult* step) { return !step->ok(); });
  return sorted;
}

Json StepJson(const v1::StepResult& step) {
  return {{"step", step.step()},
          {"ok", step.ok()},
          {"drilled", DrilledName(step.drilled())},
          {"took_ms", step.took_ms()},
          {"detail", step.detail()},
          {"output", step.output_tail()}};
}

// The end of what a program printed, each line behind `margin` and a bar.
void PrintOutput(const std::string& output, absl::string_view margin, TextStream out) {
  if (output.empty()) return;
  const std::vector<absl::string_view> lines =
      absl::StrSplit(absl::StripSuffix(output, "\n"), '\n');
  const size_t from = lines.size() - std::min(lines.size(), kOutputLinesShown);
  if (from > 0) out << margin << "| (" << from << " more above)\n";
  for (size_t i = from; i < lines.size(); ++i) {
    out << margin << "| " << EscapeText(lines[i]) << "\n";
  }
}

class ListReceipts final : public RobotCommand {
 public:
  ListReceipts()
      : RobotCommand(
            {"robot", "receipts", "Show the receipts of a robot's actuators, newest first"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    app.add_option("--limit", limit_, "Maximum number of entries (default 20)")
        ->check(CLI::Range(1, 64));
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::ListReceiptsRequest request;
    request.set_robot(robot_);
    request.set_limit(limit_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::ListReceipts, request));
    if (env.json()) {
      return PrintJson(
          env, {{"robot", robot_}, {"receipts", JsonList(response.receipts(), ReceiptJson)}});
    }
    if (response.receipts().empty()) {
      env.out << "no actuator of " << robot_ << " has sent a receipt\n";
    }
    for (int i = 0; i < response.receipts_size(); ++i) {
      if (i > 0) env.out << "\n";
      PrintReceipt(response.receipts(i), env.out);
    }
    return ExitCode::kDone;
  }

 private:
  static Json ReceiptJson(const v1::ReceivedReceipt& each) {
    const v1::Receipt& receipt = each.receipt();
    return {{"time", FullTime(each.unix_ns())},
            {"host", each.host()},
            {"command", each.command()},
            {"command_id", absl::BytesToHexString(receipt.command_id())},
            {"decision_id", receipt.has_decision_id() ? Json(DecisionIdText(receipt.decision_id()))
                                                      : Json(nullptr)},
            {"stage", StageName(receipt.stage())},
            {"effective_level", receipt.effective_level()},
            {"exit_code", receipt.exit_code()},
            {"detail", receipt.detail()},
            {"output", receipt.output_tail()},
            {"steps", JsonList(receipt.steps(), StepJson)}};
  }
  static void PrintReceipt(const v1::ReceivedReceipt& each, TextStream out) {
    const v1::Receipt& receipt = each.receipt();
    std::vector<std::string> words = {ShortTime(each.unix_ns()), EscapeText(each.host()),
                                      EscapeText(each.command()), StageName(receipt.stage())};
    if (receipt.has_decision_id())
      words.push_back(absl::StrCat("decision ", DecisionIdText(receipt.decision_id())));
    if (receipt.exit_code() != 0) words.push_back(absl::StrCat("exit code ", receipt.exit_code()));
    if (!receipt.effective_level().empty()) {
      words.push_back(absl::StrCat("held at ", EscapeText(receipt.effective_level())));
    }
    out << absl::StrJoin(words, "  ") << "\n";
    // With steps the detail only repeats those that failed.
    if (!receipt.detail().empty() && receipt.steps().empty()) {
      out << "  " << EscapeText(receipt.detail()) << "\n";
    }
    PrintOutput(receipt.output_tail(), "  ", out);
    PrintSteps(receipt.steps(), out);
  }
  // Seven characters; of a drill what was done.
  static std::string ResultText(const v1::StepResult& step) {
    if (!step.ok()) return "FAILED ";
    const bool drill = step.drilled() != v1::StepResult::DRILLED_UNSPECIFIED;
    return absl::StrFormat("%-7s", drill ? DrilledName(step.drilled()) : "ok");
  }
  static void PrintSteps(const Steps& steps, TextStream out) {
    size_t width = 0;
    for (const v1::StepResult& step : steps) {
      width = std::max(width, EscapeText(step.step()).size());
    }
    for (const v1::StepResult* step : FailedFirst(steps)) {
      const std::string name = EscapeText(step->step());
      out << "  " << ResultText(*step) << "  " << name;
      const std::string took = absl::StrCat(step->took_ms(), " ms");
      out << std::string(width - name.size() + 2 + (took.size() < 8 ? 8 - took.size() : 0), ' ')
          << took;
      if (!step->detail().empty()) out << "  " << EscapeText(step->detail());
      out << "\n";
      PrintOutput(step->output_tail(), "           ", out);
    }
  }

  uint32_t limit_ = 20;
};

// What all steps of a drill come to.
struct DrillSum {
  int steps = 0;
  int work = 0;
  int looked = 0;  // of those that work
  std::vector<std::string> failed;
  std::vector<std::string> unanswered;

  bool good() const { return failed.empty() && unanswered.empty(); }
};

DrillSum SumUp(const v1::DrillRobotResponse& response) {
  DrillSum sum;
  for (const v1::ActuatorDrill& drill : response.drills()) {
    const std::string at = absl::StrCat(drill.host(), " (", drill.level(), ")");
    bool named = false;
    for (const v1::StepResult& step : drill.steps()) {
      ++sum.steps;
      sum.work += step.ok() ? 1 : 0;
      if (step.ok()) {
        sum.looked += step.drilled() == v1::StepResult::DRILLED_LOOKED ? 1 : 0;
      } else {
        sum.failed.push_back(absl::StrCat(step.step(), " on ", at));
        named = true;
      }
    }
    if (drill.stage() == v1::Receipt::VERIFIED) continue;
    if (drill.stage() == v1::Receipt::FAILED && named) continue;
    const bool told = drill.stage() != v1::Receipt::STAGE_UNSPECIFIED;
    sum.unanswered.push_back(absl::StrCat(at, told ? ": " : "",
                                          told ? StageName(drill.stage()) : "",
                                          drill.detail().empty() ? "" : ": ", drill.detail()));
  }
  return sum;
}

class DrillRobot final : public RobotCommand {
 public:
  DrillRobot()
      : RobotCommand(
            {"robot", "drill",
             "Test the steps of a robot's levels without changing its level; exit with 1 if "
             "one fails"}) {}
  void AddFlags(CLI::App& app) override {
    RobotCommand::AddFlags(app);
    level_option_ = app.add_option("--level", level_, "Only this level; default: each in turn");
  }
  absl::Status Check() override {
    if (level_option_->count() > 0 && (level_.empty() || FindInvalidUtf8(level_))) {
      return absl::InvalidArgumentError("--level is not a level name");
    }
    return RobotCommand::Check();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::DrillRobotRequest request;
    request.set_robot(robot_);
    request.set_level(level_);
    env.timeout = std::max(env.timeout, kDrillTimeout);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::DrillRobot, request));
    const DrillSum sum = SumUp(response);
    if (env.json()) {
      PrintJson(DrillJson(response, sum), env.out);
    } else {
      PrintText(response, sum, env.out);
    }
    return sum.good() ? ExitCode::kDone : ExitCode::kRefused;
  }

 private:
  Json DrillJson(const v1::DrillRobotResponse& response, const DrillSum& sum) const {
    const auto drill_json = [](const v1::ActuatorDrill& drill) -> Json {
      return {{"level", drill.level()},
              {"host", drill.host()},
              {"stage", StageName(drill.stage())},
              {"detail", drill.detail()},
              {"steps", JsonList(drill.steps(), StepJson)}};
    };
    return {{"robot", robot_},           {"works", sum.good()},
            {"steps", sum.steps},        {"steps_work", sum.work},
            {"only_looked", sum.looked}, {"drills", JsonList(response.drills(), drill_json)}};
  }
  static const char* DoneText(v1::StepResult::Drilled drilled) {
    const bool not_tried =
        drilled == v1::StepResult::DRILLED_NOT || drilled == v1::StepResult::DRILLED_UNSPECIFIED;
    return not_tried ? "not tried" : DrilledName(drilled);
  }

  static void PrintText(const v1::DrillRobotResponse& response, const DrillSum& sum,
                        TextStream out) {
    Table table({"LEVEL", "HOST", "STEP", "DONE", "RESULT", "DETAIL"});
    for (const v1::ActuatorDrill& drill : response.drills()) {
      for (const v1::StepResult& step : drill.steps()) {
        table.Add({drill.level(), drill.host(), step.step(), DoneText(step.drilled()),
                   step.ok() ? "ok" : "FAILED", step.detail()});
      }
      if (!drill.steps().empty()) continue;
      const bool answered = drill.stage() != v1::Receipt::STAGE_UNSPECIFIED;
      const bool empty = drill.stage() == v1::Receipt::VERIFIED;
      table.Add({drill.level(), drill.host(), empty ? "(no steps)" : "(all)",
                 empty ? "" : "not tried", answered ? StageName(drill.stage()) : "NO RESPONSE",
                 drill.detail()});
    }
    table.Print(out);
    out << "\n";
    PrintOutputs(response, out);
    if (sum.looked > 0) {
      out << sum.looked << (sum.looked == 1 ? " step was" : " steps were")
          << " only looked at: what it needs is there, but it was not carried out\n";
    }
    PrintLastLine(sum, out);
  }
  // What failed programs printed.
  static void PrintOutputs(const v1::DrillRobotResponse& response, TextStream out) {
    for (const v1::ActuatorDrill& drill : response.drills()) {
      for (const v1::StepResult& step : drill.steps()) {
        if (step.ok() || step.output_tail().empty()) continue;
        out << EscapeText(step.step()) << " on " << EscapeText(drill.host()) << " ("
            << EscapeText(drill.level()) << ") printed:\n";
        PrintOutput(step.output_tail(), "  ", out);
        out << "\n";
      }
    }
  }
  static void PrintLastLine(const DrillSum& sum, TextStream out) {
    out << sum.work << " of " << sum.steps << " steps work";
    if (!sum.failed.empty()) {
      out << "; " << sum.failed.size() << (sum.failed.size() == 1 ? " does not: " : " do not: ")
          << EscapeText(absl::StrJoin(sum.failed, ", "));
    }
    if (!sum.unanswered.empty()) {
      out << "; not all were tried: " << EscapeText(absl::StrJoin(sum.unanswered, ", "));
    }
    out << "\n";
  }

  CLI::Option* level_option_ = nullptr;  // Of the application.
  std::string level_;
};

}  // namespace

Commands ActuatorCommands() { return MakeCommands<ListReceipts, DrillRobot>(); }

}  // namespace rips::ripsctl
