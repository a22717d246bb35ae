#include "policy_server/ripsctl/reference/man_page.h"

#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/strip.h"
#include "policy_server/ripsctl/cli/env.h"
#include "policy_server/ripsctl/cli/settings.h"

namespace rips::ripsctl {
namespace {

// Text of one line that means itself in roff, wherever it stands.
std::string Roff(absl::string_view text) {
  std::string out = absl::StrReplaceAll(text, {{"\\", "\\e"},
                                               {"-", "\\-"},
                                               {"\"", "\\(dq"},
                                               {"'", "\\(aq"},
                                               {"`", "\\(ga"},
                                               {"^", "\\(ha"},
                                               {"~", "\\(ti"},
                                               {"\n", " "}});
  if (!out.empty() && out[0] == '.') out.insert(0, "\\&");
  return out;
}

std::string Bold(absl::string_view text) { return absl::StrCat("\\fB", Roff(text), "\\fR"); }
std::string Italic(absl::string_view text) { return absl::StrCat("\\fI", Roff(text), "\\fR"); }

// `-h, --help`, `--limit UINT`.
std::string FlagTitle(const FlagDoc& flag, bool is_argument) {
  std::vector<std::string> names;
  for (const std::string& name : flag.names) {
    names.push_back(is_argument ? Italic(name) : Bold(name));
  }
  std::string title = absl::StrJoin(names, ", ");
  if (!is_argument && !flag.value.empty()) absl::StrAppend(&title, " ", Italic(flag.value));
  return flag.repeated ? title + " ..." : title;
}

std::string FlagText(const FlagDoc& flag) {
  std::string text = flag.text;
  const bool has_list = absl::StrContains(flag.value, '|');
  if (!flag.choices.empty() && !has_list)
    absl::StrAppend(&text, "; one of ", absl::StrJoin(flag.choices, ", "));
  if (!flag.limits.empty()) absl::StrAppend(&text, "; ", flag.limits);
  if (!flag.fallback.empty()) absl::StrAppend(&text, "; default: ", flag.fallback);
  return Roff(absl::StrCat(text, flag.required ? " (required)." : "."));
}

void AddFlags(const std::vector<FlagDoc>& flags, bool are_arguments, std::string* out) {
  for (const FlagDoc& flag : flags) {
    absl::StrAppend(out, ".TP\n", FlagTitle(flag, are_arguments), "\n", FlagText(flag), "\n");
  }
}

std::string Usage(const CommandDoc& command) {
  std::string usage = absl::StrCat(Bold(absl::StrCat("ripsctl ", command.words)), " [options]");
  for (const FlagDoc& argument : command.arguments) {
    const std::string name =
        absl::StrCat(Italic(argument.names[0]), argument.repeated ? " ..." : "");
    absl::StrAppend(&usage, " ", argument.required ? name : absl::StrCat("[", name, "]"));
  }
  return usage;
}

std::string Sentence(absl::string_view synopsis) {
  return Roff(absl::StrCat(synopsis, absl::EndsWith(synopsis, ".") ? "" : "."));
}

// The command and those below it. One that only has others below it is a title.
void AddCommand(const CommandDoc& command, std::string* out) {
  if (command.commands.empty()) {
    absl::StrAppend(out, ".SS \"ripsctl ", Roff(command.words), "\"\n", Usage(command), "\n.PP\n",
                    Sentence(command.synopsis), "\n");
    AddFlags(command.arguments, true, out);
    std::vector<FlagDoc> flags;
    for (const FlagDoc& flag : command.flags) {
      if (flag.names.back() != "--help") flags.push_back(flag);
    }
    AddFlags(flags, false, out);
    return;
  }
  absl::StrAppend(out, ".SH \"", Roff(absl::AsciiStrToUpper(command.words)), " COMMANDS\"\n",
                  Sentence(command.synopsis), "\n");
  for (const CommandDoc& each : command.commands) AddCommand(each, out);
}

void AddCommands(const CommandDoc& program, std::string* out) {
  absl::StrAppend(out, ".SH COMMANDS\nFlags of all commands, above, may stand behind a command.\n");
  for (const CommandDoc& noun : program.commands) {
    if (noun.commands.empty()) AddCommand(noun, out);
  }
  for (const CommandDoc& noun : program.commands) {
    if (!noun.commands.empty()) AddCommand(noun, out);
  }
}

void AddSurroundings(std::string* out) {
  absl::StrAppend(out, ".SH \"EXIT STATUS\"\n");
  for (const ExitCodeMeaning& each : kExitCodes) {
    absl::StrAppend(out, ".TP\n", Bold(absl::StrCat(static_cast<int>(each.code))), "\n",
                    Sentence(each.meaning), "\n");
  }
  absl::StrAppend(out, ".SH ENVIRONMENT\nA variable counts where its flag is not given.\n");
  for (const std::string& variable : SettingVariables()) {
    const std::string flag =
        absl::AsciiStrToLower(absl::StripPrefix(variable, kSettingVariablePrefix));
    absl::StrAppend(out, ".TP\n", Bold(variable), "\nAs ", Bold("--" + flag), ".\n");
  }
  absl::StrAppend(out, ".SH FILES\n.TP\n", Italic("~/.config/rips/ripsctl.yaml"),
                  "\nSettings: the names of the flags ", Roff("--server, --cert, --key, --ca, "),
                  Roff("--output and --timeout"), " as keys;\n", Bold("contexts"),
                  ", which maps names to such settings of one server each;\nand ", Bold("current"),
                  ", the name of the context in use.\n",
                  "A relative path in it is relative to its directory.\n");
}

}  // namespace

std::string ManPage(const CommandDoc& program, absl::string_view version) {
  std::string out = absl::StrCat(
      ".TH RIPSCTL 1 \"\" \"rips ", Roff(version), "\" \"User Commands\"\n.nh\n.ad l\n",
      ".SH NAME\nripsctl \\- ", "watch and control robots guarded by RIPS\n", ".SH SYNOPSIS\n",
      Bold("ripsctl"), " [options] ", Italic("command"), " [", Italic("argument"),
      " ...]\n.SH DESCRIPTION\n", Sentence(program.synopsis), "\n.SH OPTIONS\n");
  AddFlags(program.flags, false, &out);
  AddCommands(program, &out);
  AddSurroundings(&out);
  return out;
}

}  // namespace rips::ripsctl
