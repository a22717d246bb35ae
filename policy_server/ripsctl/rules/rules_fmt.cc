// `ripsctl rules fmt`: lays rule files out: prints one, rewrites them (`--write`) or names those
// that would change (`--check`). Exits with kRefused if a file does not parse, or if `--check`
// names one. JSON: {"files":[{"path","ok","diagnostics":[..],"changed":bool,"text"?}]}, `text` when
// it is printed.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "policy_server/policy/lang/format/formatter.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/rewrite_file.h"
#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/rules/rule_input.h"
#include "services/base/status_macros.h"

namespace rips::ripsctl {
namespace {

class FmtRulesCommand final : public Command {
 public:
  FmtRulesCommand()
      : Command({"rules", "fmt", "Format rule files, keeping comments; needs no server",
                 /*needs_server=*/false}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("FILE", paths_, "Rule files (- is standard input)")->required();
    CLI::Option* write =
        app.add_flag("--write", write_, "Rewrite the files and list those changed");
    app.add_flag("--check", check_, "List the files that would change; exit with 1 if any")
        ->excludes(write);
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    const bool prints = !write_ && !check_;
    if (prints && paths_.size() > 1) {
      return UsageError(env, "to print, give one file; to treat several, add --write or --check");
    }
    if (write_ && std::find(paths_.begin(), paths_.end(), kStandardInput) != paths_.end()) {
      return UsageError(env, "--write cannot rewrite standard input (`-`)");
    }
    const absl::StatusOr<std::vector<lang::SourceFile>> files = ReadRuleFiles(env, paths_);
    if (!files.ok()) return UsageError(env, files.status().message());
    Json all = Json::array();
    ExitCode code = ExitCode::kDone;
    for (const lang::SourceFile& file : *files) {
      const lang::FormatResult result = lang::Format(file);
      const bool changed = result.text.has_value() && *result.text != file.text;
      if (changed && write_) {
        RIPS_RETURN_IF_ERROR(FileError(RewriteFile(file.path, *result.text)));
      }
      if (!result.text.has_value() || (changed && check_)) code = ExitCode::kRefused;
      if (env.json()) {
        all.push_back(ToJson(file, result, changed, prints));
      } else if (!result.text.has_value()) {
        env.err << Lines{lang::RenderText({file}, result.diagnostics)};
      } else if (prints) {
        env.out.Raw(*result.text);
      } else if (changed) {
        env.out << EscapeText(file.path) << "\n";
      }
    }
    if (env.json()) PrintJson({{"files", all}}, env.out);
    return code;
  }

 private:
  static Json ToJson(const lang::SourceFile& file, const lang::FormatResult& result, bool changed,
                     bool prints) {
    Json out = Json::parse(lang::RenderJson({file}, result.diagnostics))["files"][0];
    out["changed"] = changed;
    if (prints && result.text.has_value()) out["text"] = *result.text;
    return out;
  }

  std::vector<std::string> paths_;
  bool write_ = false;
  bool check_ = false;
};

}  // namespace

Commands FormatRules() { return MakeCommands<FmtRulesCommand>(); }

}  // namespace rips::ripsctl
