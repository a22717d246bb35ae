// `ripsctl rules check`: checks rule files as one policy, or one bundle as the server does when it
// takes it. Runs nothing. Refuses what has errors, or with --werror warnings; kUsage for what
// cannot be read or is neither. Text: diagnostics, problems, and at last `ok: ...` or
// `refused: ...`. JSON, a contract: lang::RenderJson of the rule files, and of a bundle besides
// "bundle":{"name","id","ok","problems":[..],"warnings":[..]}; a refused one has no id.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/bundle/bundle.h"
#include "policy_server/policy/inspect/checked_files.h"
#include "policy_server/policy/inspect/file_source.h"
#include "policy_server/policy/lang/check/compile.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/rules/bundle_report.h"
#include "policy_server/ripsctl/rules/rule_input.h"

namespace rips::ripsctl {
namespace {

namespace fs = std::filesystem;

// The directory of the bundle that `path` means; none if it is a rule file. InvalidArgument for a
// directory that is no bundle.
absl::StatusOr<std::optional<std::string>> BundleDirectoryOf(const std::string& path) {
  std::error_code error;
  const fs::path given(path);
  if (fs::is_directory(given, error)) {
    if (fs::exists(given / bundle::kManifestName, error)) return path;
    return absl::InvalidArgumentError(absl::StrCat("directory `", path, "` has no `",
                                                   bundle::kManifestName,
                                                   "`; give a bundle, or rule files"));
  }
  if (given.filename() == bundle::kManifestName && fs::exists(given, error)) {
    return given.has_parent_path() ? given.parent_path().string() : ".";
  }
  return std::nullopt;
}

size_t CountWarnings(const std::vector<lang::Diagnostic>& diagnostics) {
  return static_cast<size_t>(
      std::count_if(diagnostics.begin(), diagnostics.end(), [](const lang::Diagnostic& diagnostic) {
        return lang::SeverityOf(diagnostic.kind) == lang::DiagnosticSeverity::kWarning;
      }));
}

class CheckRulesCommand final : public Command {
 public:
  CheckRulesCommand()
      : Command({"rules", "check",
                 "Check rule files as one policy, in this order, or a bundle; needs no server",
                 /*needs_server=*/false}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("FILE", paths_, "Rule files (- is standard input), or one bundle directory")
        ->required();
    dialect_flag_ =
        app.add_option("--dialect", dialect_, "Dialect of the rules: what the include forms mean")
            ->check(CLI::IsMember({"rips", "prototype"}))
            ->capture_default_str();
    app.add_flag("--werror", werror_, "Treat warnings as errors");
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    for (const std::string& path : paths_) {
      const absl::StatusOr<std::optional<std::string>> dir = BundleDirectoryOf(path);
      if (!dir.ok()) return UsageError(env, dir.status().message());
      if (!dir->has_value()) continue;
      if (paths_.size() > 1) {
        return UsageError(env, absl::StrCat("`", path, "` is a bundle; check it alone"));
      }
      if (dialect_flag_->count() > 0) {
        return UsageError(env, "--dialect is for rule files; a bundle's manifest says it");
      }
      return CheckBundle(env, **dir);
    }
    return CheckFiles(env);
  }

 private:
  ExitCode CheckFiles(Env& env) const {
    const absl::StatusOr<std::vector<lang::SourceFile>> files = ReadRuleFiles(env, paths_);
    if (!files.ok()) return UsageError(env, files.status().message());
    using Dialect = lang::CheckedRules::Dialect;
    const inspect::DiskFiles disk;
    inspect::CheckedFiles checked(&disk);
    const lang::CompileResult result =
        lang::Compile(*files, {.dialect = dialect_ == "rips" ? Dialect::kRips : Dialect::kPrototype,
                               .inspection_files = &checked});
    if (env.json()) {
      PrintJson(Json::parse(lang::RenderJson(*files, result.diagnostics)), env.out);
    } else {
      env.out << Lines{lang::RenderText(*files, result.diagnostics)};
    }
    if (!result.rules.has_value()) return ExitCode::kRefused;
    return Accepted(env, CountWarnings(result.diagnostics),
                    absl::StrCat(result.rules->rules.size(), " rules, ",
                                 result.rules->levels.size(), " levels"));
  }

  ExitCode CheckBundle(Env& env, const std::string& dir) const {
    const bundle::BundleCheck check = bundle::CheckBundle(dir);
    if (env.json()) {
      PrintJson(BundleCheckJson(check), env.out);
    } else {
      PrintBundleCheck(check, env.out);
    }
    if (!check.ok()) return ExitCode::kRefused;
    return Accepted(env, CountWarnings(check.diagnostics) + check.warnings.size(),
                    absl::StrCat("bundle `", check.name, "`, ", check.rules, " rules, ",
                                 check.levels, " levels, ", check.id));
  }

  ExitCode Accepted(Env& env, size_t warnings, absl::string_view what) const {
    const bool refused = werror_ && warnings > 0;
    if (!env.json() && refused) {
      env.out << "refused: " << warnings << (warnings == 1 ? " warning" : " warnings")
              << ", and --werror is given\n";
    } else if (!env.json()) {
      env.out << "ok: " << what << "\n";
    }
    return refused ? ExitCode::kRefused : ExitCode::kDone;
  }

  std::vector<std::string> paths_;
  std::string dialect_ = "rips";
  CLI::Option* dialect_flag_ = nullptr;  // Not owned; outlives this.
  bool werror_ = false;
};

}  // namespace

Commands CheckRules() { return MakeCommands<CheckRulesCommand>(); }

}  // namespace rips::ripsctl
