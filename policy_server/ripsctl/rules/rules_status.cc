// `ripsctl rules status`: the newest roll-out, and by which bundle each robot is judged. Exits with
// 1 if a robot has a problem or has not answered. JSON: {"rollout":{..} or null,"robots":[{"robot",
// "policy","bundle_in_use","activated","operator","since","reason","before","problem","shadow"}],
// "no_answer":[..],"cut"}. `bundle_in_use` is null if nothing judges the robot; `activated` and
// `before` are an id or `directory`, `before` null if there is nothing to go back to; `operator`,
// `since` and `reason` are null if no operator activated it. `shadow`: null, or {"bundle","name",
// "operator","reason","began","events","missed","problem","level","live_level","would":{counts},
// "live":{counts},"rules":[{"rule","fired","unscanned","undecidable"}],"examples":[{"time","kind",
// "rule","text"}]}.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/rules/rollout_text.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

// What is counted, with its name in text and JSON.
constexpr std::pair<const char*, uint64_t (v1::ShadowCounts::*)() const> kCounts[] = {
    {"alerts", &v1::ShadowCounts::alerts},       {"raises", &v1::ShadowCounts::raises},
    {"lowerings", &v1::ShadowCounts::lowerings}, {"refusals", &v1::ShadowCounts::refusals},
    {"programs", &v1::ShadowCounts::programs},   {"faults", &v1::ShadowCounts::faults},
};

Json CountsJson(const v1::ShadowCounts& counts) {
  Json json;
  for (const auto& [name, get] : kCounts) json[name] = (counts.*get)();
  return json;
}

Json ShadowJson(const v1::ShadowReport& shadow) {
  const auto rule_json = [](const v1::ShadowRule& rule) -> Json {
    return {{"rule", rule.rule()},
            {"fired", rule.fired()},
            {"unscanned", rule.unscanned()},
            {"undecidable", rule.undecidable()}};
  };
  const auto example_json = [](const v1::ShadowExample& example) -> Json {
    return {{"time", FullTime(example.time_unix_ns())},
            {"kind", example.kind()},
            {"rule", example.rule()},
            {"text", example.text()}};
  };
  return {{"bundle", shadow.bundle_id()},
          {"name", shadow.name()},
          {"operator", shadow.operator_()},
          {"reason", shadow.reason()},
          {"began", FullTime(shadow.began_unix_ns())},
          {"events", shadow.events()},
          {"missed", shadow.missed()},
          {"problem", shadow.problem()},
          {"level", shadow.level()},
          {"live_level", shadow.live_level()},
          {"would", CountsJson(shadow.would())},
          {"live", CountsJson(shadow.live())},
          {"rules", JsonList(shadow.rules(), rule_json)},
          {"examples", JsonList(shadow.examples(), example_json)}};
}

std::string OrDirectory(const std::string& id) {
  return id.empty() ? std::string(kDirectoryBundle) : id;
}

Json RobotJson(const v1::RobotRules& rules) {
  const auto if_activated = [&rules](Json value) {
    return rules.operator_().empty() ? Json(nullptr) : value;
  };
  return {{"robot", rules.robot()},
          {"policy", rules.name()},
          {"bundle_in_use",
           rules.bundle_in_use().empty() ? Json(nullptr) : Json(rules.bundle_in_use())},
          {"activated", OrDirectory(rules.activated())},
          {"operator", if_activated(rules.operator_())},
          {"since", if_activated(FullTime(rules.activated_unix_ns()))},
          {"reason", if_activated(rules.reason())},
          {"before", rules.can_roll_back() ? Json(OrDirectory(rules.before())) : Json(nullptr)},
          {"problem", rules.problem()},
          {"shadow", rules.has_shadow() ? ShadowJson(rules.shadow()) : Json(nullptr)}};
}

bool Contains(const google::protobuf::RepeatedPtrField<std::string>& robots,
              const std::string& robot) {
  return std::find(robots.begin(), robots.end(), robot) != robots.end();
}

// Empty if there is nothing to say.
std::string ProblemOf(const v1::RobotRules& rules, const v1::GetRulesStatusResponse& response) {
  if (Contains(response.no_answer(), rules.robot())) {
    return "no response in time: the server is overloaded";
  }
  if (rules.problem().empty() && rules.bundle_in_use().empty()) return "nothing judges it";
  return rules.problem();
}

// `muted: sha256:0123`, if a shadow runs.
std::string ShadowText(const v1::RobotRules& rules) {
  if (!rules.has_shadow()) return "";
  const v1::ShadowReport& shadow = rules.shadow();
  return absl::StrCat("shadow ", ShortBundle(shadow.bundle_id()), ": would have raised ",
                      shadow.would().raises(), " times and alerted ", shadow.would().alerts(),
                      ", the live one ", shadow.live().raises(), " and ", shadow.live().alerts(),
                      shadow.problem().empty() ? "" : absl::StrCat("; ", shadow.problem()));
}

// The table of robots, what there is to say of one below it; those with a problem first.
void PrintRobots(const v1::GetRulesStatusResponse& response, TextStream out) {
  std::vector<const v1::RobotRules*> robots;
  for (const v1::RobotRules& rules : response.robots()) robots.push_back(&rules);
  std::stable_partition(robots.begin(), robots.end(), [&](const v1::RobotRules* rules) {
    return !ProblemOf(*rules, response).empty();
  });
  Table table({"ROBOT", "POLICY", "IN USE", "ACTIVATED", "BY", "SINCE"});
  for (const v1::RobotRules* rules : robots) {
    table.Add({rules->robot(), rules->name(), ShortBundle(rules->bundle_in_use()),
               ShortBundleOrDirectory(rules->activated()), WithoutCertificates(rules->operator_()),
               ShortTime(rules->activated_unix_ns())});
  }
  std::stringstream lines;
  table.Print(lines);
  std::string line;
  std::getline(lines, line);
  out << line << "\n";
  for (const v1::RobotRules* rules : robots) {
    std::getline(lines, line);
    out << line << "\n";
    for (const std::string& text : {ProblemOf(*rules, response), ShadowText(*rules)}) {
      if (!text.empty()) out << "  " << EscapeText(text) << "\n";
    }
  }
}

// What the shadow would have done beside what was done, then its rules and examples.
void PrintShadow(const v1::ShadowReport& shadow, TextStream out) {
  Table about({"shadow", EscapeText(absl::StrCat(shadow.bundle_id(), " `", shadow.name(), "`"))});
  about.Add({"by", shadow.operator_()});
  about.Add({"reason", shadow.reason()});
  about.Add({"counts since", absl::StrCat(ShortTime(shadow.began_unix_ns()),
                                          " (the server's start at the earliest)")});
  about.Add({"events", absl::StrCat(shadow.events())});
  if (shadow.missed() > 0) {
    about.Add(
        {"missed", absl::StrCat(shadow.missed(), ": it is too slow; its counts are too low")});
  }
  if (!shadow.problem().empty()) about.Add({"problem", shadow.problem()});
  about.Print(out);
  Table counts({"", "WOULD", "LIVE"});
  counts.Add({"level", shadow.level(), shadow.live_level()});
  for (const auto& [name, get] : kCounts) {
    counts.Add({name, absl::StrCat((shadow.would().*get)()), absl::StrCat((shadow.live().*get)())});
  }
  counts.Print(out);
  if (!shadow.rules().empty()) {
    Table rules({"RULE", "FIRED", "UNSCANNED", "UNDECIDABLE"});
    for (const v1::ShadowRule& rule : shadow.rules()) {
      rules.Add({rule.rule(), absl::StrCat(rule.fired()), absl::StrCat(rule.unscanned()),
                 absl::StrCat(rule.undecidable())});
    }
    rules.Print(out);
  }
  if (shadow.examples().empty()) return;
  Table examples({"TIME", "KIND", "RULE", "THE FIRST AND THE NEWEST THINGS IT WOULD HAVE DONE"});
  for (const v1::ShadowExample& example : shadow.examples()) {
    examples.Add(
        {ShortTime(example.time_unix_ns()), example.kind(), example.rule(), example.text()});
  }
  examples.Print(out);
}

// All there is to say of one robot.
void PrintRobot(const v1::RobotRules& rules, const v1::GetRulesStatusResponse& response,
                TextStream out) {
  Table table({"robot", EscapeText(rules.robot())});
  table.Add({"policy", rules.name()});
  table.Add({"in use", rules.bundle_in_use()});
  table.Add({"activated", OrDirectory(rules.activated())});
  if (!rules.operator_().empty()) {
    table.Add({"by", absl::StrCat(rules.operator_(), ", ", ShortTime(rules.activated_unix_ns()))});
    table.Add({"reason", rules.reason()});
  }
  table.Add({"goes back to", rules.can_roll_back() ? OrDirectory(rules.before()) : "nothing"});
  if (const std::string problem = ProblemOf(rules, response); !problem.empty()) {
    table.Add({"problem", problem});
  }
  table.Print(out);
  if (!rules.has_shadow()) return;
  out << "\n";
  PrintShadow(rules.shadow(), out);
}

class RulesStatusCommand final : public Command {
 public:
  RulesStatusCommand()
      : Command({"rules", "status",
                 "Show the roll-out and what judges each robot; of one ROBOT, what its shadow "
                 "would do, too"}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id; default: all");
  }
  absl::Status Check() override { return robot_.empty() ? absl::OkStatus() : CheckRobot(robot_); }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    v1::GetRulesStatusRequest request;
    request.set_robot(robot_);
    RIPS_ASSIGN_OR_RETURN(const auto response, Call(env, &Stub::GetRulesStatus, request));
    const auto& robots = response.robots();
    const bool good = std::all_of(robots.begin(), robots.end(), [&](const v1::RobotRules& rules) {
      return ProblemOf(rules, response).empty();
    });
    const ExitCode code = good ? ExitCode::kDone : ExitCode::kRefused;
    if (env.json()) {
      PrintJson({{"rollout", ToJson(response.rollout())},
                 {"robots", JsonList(robots, RobotJson)},
                 {"no_answer", JsonList(response.no_answer())},
                 {"cut", response.cut()}},
                env.out);
      return code;
    }
    PrintRollout(response.rollout(), absl::GetCurrentTimeNanos(), env.out);
    env.out << "\n";
    if (robot_.empty()) PrintRobots(response, env.out);
    if (!robot_.empty()) {
      for (const v1::RobotRules& rules : robots) PrintRobot(rules, response, env.out);
    }
    if (response.cut()) {
      env.out << "more robots than fit into one answer; ask for one: ripsctl rules status ROBOT\n";
    }
    return code;
  }

 private:
  std::string robot_;
};

}  // namespace

Commands RulesStatus() { return MakeCommands<RulesStatusCommand>(); }

}  // namespace rips::ripsctl
