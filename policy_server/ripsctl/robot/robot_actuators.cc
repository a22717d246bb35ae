#include "policy_server/ripsctl/robot/robot_actuators.h"

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
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/robot/robot_verb.h"

namespace rips::ripsctl {
namespace {

const char* StageName(v1::Receipt::Stage stage) {
  switch (stage) {
    case v1::Receipt::ACKNOWLEDGED:
      return "acknowledged";
    case v1::Receipt::VERIFIED:
      return "verified";
    case v1::Receipt::FAILED:
      return "failed";
    case v1::Receipt::SUPERSEDED:
      return "superseded";
    case v1::Receipt::REFUSED_STALE:
      return "refused_stale";
    case v1::Receipt::REFUSED:
      return "refused";
    case v1::Receipt::UNKNOWN:
      return "unknown";
    default:
      return "none";
  }
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

Json StepsToJson(const Steps& steps) {
  Json list = Json::array();
  for (const v1::StepResult& step : steps) {
    list.push_back({{"step", step.step()},
                    {"ok", step.ok()},
                    {"drilled", DrilledName(step.drilled())},
                    {"took_ms", step.took_ms()},
                    {"detail", step.detail()},
                    {"output", step.output_tail()}});
  }
  return list;
}

// The end of what a program printed, each line behind `margin` and a bar.
void PrintOutput(const std::string& output, absl::string_view margin, std::ostream& out) {
  if (output.empty()) return;
  const std::vector<absl::string_view> lines =
      absl::StrSplit(absl::StripSuffix(output, "\n"), '\n');
  const size_t from = lines.size() - std::min(lines.size(), kOutputLinesShown);
  if (from > 0) out << margin << "| (" << from << " more above)\n";
  for (size_t i = from; i < lines.size(); ++i) {
    out << margin << "| " << EscapeText(lines[i]) << "\n";
  }
}

class ListReceipts final : public RobotVerb {
 public:
  absl::string_view verb() const override { return "receipts"; }
  absl::string_view synopsis() const override {
    return "Show what a robot's actuators answered, newest first";
  }

 private:
  void AddMore(CLI::App& app) override {
    app.add_option("--limit", limit_, "At most so many (default 20)")->check(CLI::Range(1, 64));
  }
  ExitCode RunFor(Env& env, const std::string& robot) override {
    v1::ListReceiptsRequest request;
    request.set_robot(robot);
    request.set_limit(limit_);
    const auto response = Call(env, &Stub::ListReceipts, request);
    if (!response.ok()) return Failed(env, response.status());
    if (env.json()) {
      PrintJson(ReceiptsJson(robot, *response), env.out);
    } else if (response->receipts().empty()) {
      env.out << "no actuator of " << robot << " has answered since the server's start\n";
    } else {
      for (int i = 0; i < response->receipts_size(); ++i) {
        if (i > 0) env.out << "\n";
        PrintReceipt(response->receipts(i), env.out);
      }
    }
    return ExitCode::kDone;
  }

  static Json ReceiptsJson(const std::string& robot, const v1::ListReceiptsResponse& response) {
    Json list = Json::array();
    for (const v1::ReceivedReceipt& each : response.receipts()) {
      const v1::Receipt& receipt = each.receipt();
      list.push_back(
          {{"time", FullTime(each.unix_ns())},
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
           {"steps", StepsToJson(receipt.steps())}});
    }
    return {{"robot", robot}, {"receipts", std::move(list)}};
  }

  static void PrintReceipt(const v1::ReceivedReceipt& each, std::ostream& out) {
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
  static void PrintSteps(const Steps& steps, std::ostream& out) {
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

class DrillRobot final : public RobotVerb {
 public:
  absl::string_view verb() const override { return "drill"; }
  absl::string_view synopsis() const override {
    return "Try a robot's levels without changing its level; exit with 1 if a step does not work";
  }

 private:
  void AddMore(CLI::App& app) override {
    level_option_ = app.add_option("--level", level_, "Only this level; default: each in turn");
  }
  ExitCode RunFor(Env& env, const std::string& robot) override {
    if (level_option_->count() > 0 && (level_.empty() || !IsUtf8(level_))) {
      return UsageError(env, "--level is not a level name");
    }
    v1::DrillRobotRequest request;
    request.set_robot(robot);
    request.set_level(level_);
    Env patient = env;
    patient.timeout = std::max(env.timeout, kDrillTimeout);
    const auto response = Call(patient, &Stub::DrillRobot, request);
    if (!response.ok()) return Failed(patient, response.status());
    const DrillSum sum = SumUp(*response);
    if (env.json()) {
      PrintJson(DrillJson(robot, *response, sum), env.out);
    } else {
      PrintText(*response, sum, env.out);
    }
    return sum.good() ? ExitCode::kDone : ExitCode::kRefused;
  }

  static Json DrillJson(const std::string& robot, const v1::DrillRobotResponse& response,
                        const DrillSum& sum) {
    Json drills = Json::array();
    for (const v1::ActuatorDrill& drill : response.drills()) {
      drills.push_back({{"level", drill.level()},
                        {"host", drill.host()},
                        {"stage", StageName(drill.stage())},
                        {"detail", drill.detail()},
                        {"steps", StepsToJson(drill.steps())}});
    }
    return {{"robot", robot},         {"works", sum.good()},       {"steps", sum.steps},
            {"steps_work", sum.work}, {"only_looked", sum.looked}, {"drills", std::move(drills)}};
  }

  static const char* DoneText(v1::StepResult::Drilled drilled) {
    const bool not_tried =
        drilled == v1::StepResult::DRILLED_NOT || drilled == v1::StepResult::DRILLED_UNSPECIFIED;
    return not_tried ? "not tried" : DrilledName(drilled);
  }

  static void PrintText(const v1::DrillRobotResponse& response, const DrillSum& sum,
                        std::ostream& out) {
    Table table({"LEVEL", "HOST", "STEP", "DONE", "RESULT", "DETAIL"});
    for (const v1::ActuatorDrill& drill : response.drills()) {
      for (const v1::StepResult& step : drill.steps()) {
        table.Add({drill.level(), drill.host(), step.step(), DoneText(step.drilled()),
                   step.ok() ? "ok" : "FAILED", step.detail()});
      }
      if (!drill.steps().empty()) continue;
      const bool answered = drill.stage() != v1::Receipt::STAGE_UNSPECIFIED;
      const bool empty = drill.stage() == v1::Receipt::VERIFIED;
      table.Add({drill.level(), drill.host(), empty ? "(it has none)" : "(all)",
                 empty ? "" : "not tried", answered ? StageName(drill.stage()) : "NO ANSWER",
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
  static void PrintOutputs(const v1::DrillRobotResponse& response, std::ostream& out) {
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
  static void PrintLastLine(const DrillSum& sum, std::ostream& out) {
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

Commands ActuatorCommands() {
  Commands commands;
  commands.push_back(std::make_unique<ListReceipts>());
  commands.push_back(std::make_unique<DrillRobot>());
  return commands;
}

}  // namespace rips::ripsctl
