#include "policy_server/ripsctl/reference/bash_completion.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/string_view.h"

namespace rips::ripsctl {
namespace {

constexpr absl::string_view kHead =
    R"(# Completion of ripsctl for bash; `ripsctl completion bash` prints it.

# Sets commands, flags, valued (flags that take a value) and argument of the command in $1.
_ripsctl_command() {
  commands="" flags="" valued="" argument=""
  case "$1" in
)";
constexpr absl::string_view kBetween = R"(  esac
}

# Sets choices to the values of the flag or argument in $2 of the command in $1.
_ripsctl_choices() {
  choices=""
  case "$1 $2" in
)";
constexpr absl::string_view kTail = R"(  esac
}

_ripsctl() {
  local cur=${COMP_WORDS[COMP_CWORD]} command="" pending="" word i
  local commands flags valued argument choices global_flags global_valued
  _ripsctl_command ""
  global_flags=$flags global_valued=$valued
  for ((i = 1; i < COMP_CWORD; ++i)); do
    word=${COMP_WORDS[i]}
    if [[ $word == "=" ]]; then continue; fi
    if [[ -n $pending ]]; then
      pending=""
    elif [[ $word == -* ]]; then
      if [[ " $valued $global_valued " == *" $word "* ]]; then pending=$word; fi
    elif [[ " $commands " == *" $word "* ]]; then
      command="${command:+$command }$word"
      _ripsctl_command "$command"
    fi
  done
  if [[ $cur == "=" ]]; then cur=""; fi
  COMPREPLY=()
  if [[ -n $pending ]]; then
    _ripsctl_choices "$command" "$pending"
  elif [[ $cur == -* ]]; then
    choices="$flags $global_flags"
  elif [[ -n $commands ]]; then
    choices=$commands
  else
    _ripsctl_choices "$command" "$argument"
  fi
  if [[ -n $choices ]]; then
    mapfile -t COMPREPLY < <(compgen -W "$choices" -- "$cur" | sort -u)
  else
    compopt -o default 2>/dev/null
  fi
}

complete -F _ripsctl ripsctl
)";

// A value whose choices are not in the tree, and how they are found. compgen expands them, so only
// names may come, which are safe (ValidateName): never the JSON that the settings may ask for.
constexpr absl::string_view kContext = "CONTEXT";
constexpr absl::string_view kContexts =
    R"($("${COMP_WORDS[0]}" context list --names --output text 2>/dev/null))";

// In single quotes, as one word.
std::string Quoted(absl::string_view text) {
  return absl::StrCat("'", absl::StrReplaceAll(text, {{"'", "'\\''"}}), "'");
}

void AddCase(const CommandDoc& command, std::string* out) {
  std::vector<std::string> commands;
  std::vector<std::string> flags;
  std::vector<std::string> valued;
  for (const CommandDoc& each : command.commands) {
    commands.push_back(each.words.substr(each.words.rfind(' ') + 1));
  }
  for (const FlagDoc& flag : command.flags) {
    flags.insert(flags.end(), flag.names.begin(), flag.names.end());
    if (!flag.value.empty()) valued.insert(valued.end(), flag.names.begin(), flag.names.end());
  }
  const std::string argument = command.arguments.empty() ? "" : command.arguments[0].names[0];
  absl::StrAppend(
      out, "    ", Quoted(command.words), ") commands=", Quoted(absl::StrJoin(commands, " ")),
      " flags=", Quoted(absl::StrJoin(flags, " ")), " valued=", Quoted(absl::StrJoin(valued, " ")),
      " argument=", Quoted(argument), " ;;\n");
  for (const CommandDoc& each : command.commands) AddCase(each, out);
}

// Flags of the program may stand behind every command.
void AddChoices(const CommandDoc& command, std::string* out) {
  const std::string before = command.words.empty() ? "*' '" : Quoted(command.words + " ");
  std::vector<FlagDoc> all = command.flags;
  all.insert(all.end(), command.arguments.begin(), command.arguments.end());
  for (const CommandDoc& each : command.commands) AddChoices(each, out);
  for (const FlagDoc& flag : all) {
    const bool is_context = flag.value == kContext;
    if (flag.choices.empty() && !is_context) continue;
    for (const std::string& name : flag.names) {
      absl::StrAppend(
          out, "    ", before, Quoted(name), ") ", "choices=",
          is_context ? std::string(kContexts) : Quoted(absl::StrJoin(flag.choices, " ")), " ;;\n");
    }
  }
}

}  // namespace

std::string BashCompletion(const CommandDoc& program) {
  std::string out(kHead);
  AddCase(program, &out);
  absl::StrAppend(&out, kBetween);
  AddChoices(program, &out);
  absl::StrAppend(&out, kTail);
  return out;
}

}  // namespace rips::ripsctl
