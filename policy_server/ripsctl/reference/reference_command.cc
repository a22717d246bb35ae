// `ripsctl completion`, `ripsctl man`: the command line about itself.
#include <CLI/CLI.hpp>
#include <string>

#include "policy_server/ripsctl/commands.h"
#include "policy_server/ripsctl/reference/bash_completion.h"
#include "policy_server/ripsctl/reference/command_tree.h"
#include "policy_server/ripsctl/reference/man_page.h"
#include "services/runtime/daemon_flags.h"

namespace rips::ripsctl {
namespace {

// A command that needs the tree of commands, and no settings.
class ReferenceCommand : public Command {
 public:
  ReferenceCommand(const char* noun, const char* verb, const char* synopsis)
      : Command({.noun = noun,
                 .verb = verb,
                 .synopsis = synopsis,
                 .needs_server = false,
                 .uses = SettingsUse::kNothing}) {}
  // The tree is not whole yet.
  void AddFlags(CLI::App& app) override { app_ = &app; }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    env.out.Raw(Text(DescribeCommands(*app_)));
    return ExitCode::kDone;
  }

 private:
  virtual std::string Text(const CommandDoc& program) const = 0;

  const CLI::App* app_ = nullptr;  // Not owned; outlives this.
};

class CompleteBash final : public ReferenceCommand {
 public:
  CompleteBash()
      : ReferenceCommand("completion", "bash",
                         "Print the completion for bash; in ~/.bashrc: source <(ripsctl completion "
                         "bash)") {}

 private:
  std::string Text(const CommandDoc& program) const override { return BashCompletion(program); }
};

class PrintManPage final : public ReferenceCommand {
 public:
  PrintManPage() : ReferenceCommand("man", "", "Print ripsctl(1), the manual page, in roff") {}

 private:
  std::string Text(const CommandDoc& program) const override {
    return ManPage(program, RipsVersion());
  }
};

}  // namespace

Commands ReferenceCommands() { return MakeCommands<CompleteBash, PrintManPage>(); }

}  // namespace rips::ripsctl
