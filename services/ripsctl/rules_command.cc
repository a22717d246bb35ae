#include "services/ripsctl/rules_command.h"

#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/inspect/checked_files.h"
#include "policy_server/inspect/file_source.h"
#include "policy_server/lang/compile.h"
#include "policy_server/lang/limits.h"
#include "services/ripsctl/json_view.h"
#include "services/ripsctl/printer.h"
#include "services/ripsctl/rules_builtins.h"
#include "services/ripsctl/rules_fmt.h"
#include "services/ripsctl/rules_replay.h"
#include "services/ripsctl/rules_test_command.h"
#include "services/runtime/atomic_file.h"

namespace rips::ripsctl {
namespace {

class RulesCommand : public Command {
 public:
  absl::string_view noun() const final { return "rules"; }
};

class CheckRules final : public RulesCommand {
 public:
  absl::string_view verb() const override { return "check"; }
  absl::string_view synopsis() const override {
    return "Check rule files as one policy, in this order; needs no server";
  }
  bool needs_server() const override { return false; }
  void AddFlags(CLI::App& app) override {
    app.add_option("FILE", paths_, "Rule files")->required();
    app.add_option("--dialect", dialect_, "What the include forms mean")
        ->check(CLI::IsMember({"rips", "prototype"}))
        ->capture_default_str();
  }
  ExitCode Run(Env& env) override {
    std::vector<lang::SourceFile> files;
    for (const std::string& path : paths_) {
      absl::StatusOr<std::string> text = ReadFile(path, lang::kFileBytesMax);
      if (!text.ok()) return UsageError(env, text.status().message());
      files.push_back({.path = path, .text = *std::move(text)});
    }
    using Dialect = lang::CheckedRules::Dialect;
    const inspect::DiskFiles disk;
    inspect::CheckedFiles checked(&disk);
    const lang::CompileResult result =
        lang::Compile(files, {.dialect = dialect_ == "rips" ? Dialect::kRips : Dialect::kPrototype,
                              .inspection_files = &checked});
    if (env.json()) {
      env.out << lang::RenderJson(files, result.diagnostics) << "\n";
    } else {
      env.out << lang::RenderText(files, result.diagnostics);
      if (result.rules.has_value()) {
        env.out << "ok: " << result.rules->rules.size() << " rules, " << result.rules->levels.size()
                << " levels\n";
      }
    }
    return result.rules.has_value() ? ExitCode::kDone : ExitCode::kRefused;
  }

 private:
  std::vector<std::string> paths_;
  std::string dialect_ = "rips";
};

class ResumeRules final : public RulesCommand {
 public:
  absl::string_view verb() const override { return "resume"; }
  absl::string_view synopsis() const override {
    return "Let rules lower soft levels again after their budget was spent";
  }
  void AddFlags(CLI::App& app) override {
    app.add_option("ROBOT", robot_, "Robot id")->required();
    app.add_option("--reason", reason_, "Why; kept by the server")->required();
  }
  ExitCode Run(Env& env) override {
    absl::Status valid = CheckRobot(robot_);
    if (valid.ok()) valid = CheckReason(reason_);
    if (!valid.ok()) return UsageError(env, valid.message());
    v1::ResumeRulesRequest request;
    request.set_robot(robot_);
    request.set_reason(reason_);
    const auto response = Call(env, &Stub::ResumeRules, request);
    if (!response.ok()) return Failed(env, response.status());
    if (env.json()) {
      PrintJson({{"robot", robot_}, {"resumed", true}}, env.out);
    } else {
      env.out << "rules of " << robot_ << " may lower soft levels again\n";
    }
    return ExitCode::kDone;
  }

 private:
  std::string robot_;
  std::string reason_;
};

}  // namespace

Commands RulesCommands() {
  Commands commands;
  commands.push_back(std::make_unique<CheckRules>());
  commands.push_back(FmtRules());
  commands.push_back(RulesBuiltins());
  commands.push_back(TestRules());
  commands.push_back(ReplayRules());
  commands.push_back(std::make_unique<ResumeRules>());
  return commands;
}

}  // namespace rips::ripsctl
