// `ripsctl context`: list, use.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <string>

#include "absl/strings/str_cat.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/rewrite_file.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/status_macros.h"
#include "services/runtime/config_sections.h"

namespace rips::ripsctl {
namespace {

Command::Info OfContext(const char* verb, const char* synopsis) {
  return {.noun = "context",
          .verb = verb,
          .synopsis = synopsis,
          .needs_server = false,
          .uses = SettingsUse::kFile};
}

class ListContexts final : public Command {
 public:
  ListContexts()
      : Command(OfContext("list", "List contexts with their servers; needs no server")) {}
  void AddFlags(CLI::App& app) override {
    app.add_flag("--names", names_, "Print only the names, one a line");
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    const SettingsFile& file = env.settings_file;
    if (env.json()) return PrintAsJson(env);
    Table table({"CURRENT", "CONTEXT", "SERVER"});
    for (const auto& [name, settings] : file.contexts) {
      if (names_) env.out << name << "\n";
      table.Add({name == file.current ? "*" : "", name, settings.server});
    }
    if (names_) return ExitCode::kDone;
    if (file.contexts.empty()) {
      env.err << "no contexts in " << EscapeText(env.settings_path) << "\n";
      return ExitCode::kDone;
    }
    table.Print(env.out);
    const absl::Status current =
        file.current.empty() ? absl::OkStatus()
                             : CheckContext(file.current, "`current` of the settings file", file);
    if (!current.ok()) env.err << "warning: " << EscapeText(current.message()) << "\n";
    return ExitCode::kDone;
  }

 private:
  static ExitCode PrintAsJson(Env& env) {
    const SettingsFile& file = env.settings_file;
    Json contexts = Json::array();
    for (const auto& [name, settings] : file.contexts) {
      contexts.push_back({{"name", name}, {"server", settings.server}});
    }
    const Json current = file.current.empty() ? Json(nullptr) : Json(file.current);
    return PrintJson(env, {{"contexts", contexts}, {"current", current}});
  }

  bool names_ = false;
};

class UseContext final : public Command {
 public:
  UseContext() : Command(OfContext("use", "Make a context the current one; needs no server")) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("CONTEXT", name_, "Name of a context of the settings file")
        ->type_name("CONTEXT")
        ->required();
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    if (const absl::Status known = CheckContext(name_, "CONTEXT", env.settings_file); !known.ok()) {
      return UsageError(env, known.message());
    }
    // No failure of the server: Failed would say so of an Unavailable.
    if (const absl::Status written = Write(env.settings_path); !written.ok()) {
      env.err << "error: " << EscapeText(written.message()) << "\n";
      return ExitCode::kRefused;
    }
    if (env.json()) return PrintJson(env, {{"current", name_}});
    env.out << "context " << name_ << " is the current one: server "
            << EscapeText(env.settings_file.contexts.at(name_).server) << "\n";
    return ExitCode::kDone;
  }

 private:
  absl::Status Write(const std::string& path) const {
    RIPS_ASSIGN_OR_RETURN(const std::string text, ReadConfigFile(path));
    RIPS_ASSIGN_OR_RETURN(const std::string changed, WithCurrentContext(path, text, name_));
    return changed == text ? absl::OkStatus() : RewriteFile(path, changed);
  }

  std::string name_;
};

}  // namespace

Commands ContextCommands() { return MakeCommands<ListContexts, UseContext>(); }

}  // namespace rips::ripsctl
