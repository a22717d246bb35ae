// `ripsctl rules builtins`: the reference of the rule language, from the tables that its checker
// reads, as text, as Markdown (`--markdown`) or as JSON:
// [{"name","kind":"builtin|action|predefined","class":"universal|Msg|Graph|External","usage",
//   "result","help","extension":bool,"words":[{"parameter","after"?,"values":[..]}]}]
// `extension`: an addition, so a program may declare the name as its own. `words`: what a parameter
// may be; `after`: if the argument before it is this.
#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/check/type.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/text/nearest.h"

namespace rips::ripsctl {
namespace {

using lang::EventClass;

// What a parameter may be, if the argument before it is `after`, unless that is empty. Views of the
// tables, which are constant; so are those of an entry.
struct Words {
  absl::string_view parameter;
  absl::string_view after;
  std::span<const absl::string_view> values;
};

struct Entry {
  enum class Kind { kBuiltin, kAction, kPredefined };
  Kind kind;
  EventClass event_class;
  absl::string_view name;
  std::string usage;
  absl::string_view result;
  absl::string_view help;
  bool extension;
  std::vector<Words> words;
};

absl::string_view Name(Entry::Kind kind) {
  switch (kind) {
    case Entry::Kind::kBuiltin:
      return "builtin";
    case Entry::Kind::kAction:
      return "action";
    case Entry::Kind::kPredefined:
      return "predefined";
  }
  return "";
}

std::vector<Words> WordsOf(const lang::Signature& signature) {
  std::vector<Words> out;
  std::span<const absl::string_view> before;
  for (const lang::Parameter& parameter : signature.parameters) {
    if (parameter.role != lang::ParameterRole::kWord) continue;
    if (!parameter.words.empty()) {
      out.push_back({.parameter = parameter.name, .after = "", .values = parameter.words});
    } else {
      for (absl::string_view kind : before) {
        out.push_back(
            {.parameter = parameter.name, .after = kind, .values = lang::AgentStates(kind)});
      }
    }
    before = parameter.words;
  }
  return out;
}

std::vector<Words> WordsOf(const lang::ActionSignature& action) {
  if (action.action != lang::ActionKind::kAlert) return {};
  return {{.parameter = "severity", .after = "", .values = lang::Severities()}};
}

std::vector<Entry> AllEntries() {
  std::vector<Entry> out;
  for (const lang::Signature& signature : lang::Signatures()) {
    out.push_back({.kind = Entry::Kind::kBuiltin,
                   .event_class = signature.event_class,
                   .name = signature.name,
                   .usage = lang::UsageOf(signature),
                   .result = lang::Name(signature.result),
                   .help = signature.help,
                   .extension = signature.extension,
                   .words = WordsOf(signature)});
  }
  for (const lang::PredefinedName& name : lang::PredefinedNames()) {
    out.push_back({.kind = Entry::Kind::kPredefined,
                   .event_class = name.event_class,
                   .name = name.name,
                   .usage = std::string(name.name),
                   .result = lang::Name(name.type),
                   .help = name.help,
                   .extension = name.extension,
                   .words = {}});
  }
  for (const lang::ActionSignature& action : lang::ActionSignatures()) {
    out.push_back({.kind = Entry::Kind::kAction,
                   .event_class = EventClass::kUniversal,
                   .name = action.name,
                   .usage = std::string(action.usage),
                   .result = lang::Name(lang::ValueType::kBool),
                   .help = action.help,
                   .extension = false,
                   .words = WordsOf(action)});
  }
  return out;
}

// The help and the words: `...; kind: "sensor", "actuator"; state after "sensor": ...`
std::string HelpOf(const Entry& entry) {
  std::string out(entry.help);
  for (const Words& words : entry.words) {
    absl::StrAppend(&out, "; ", words.parameter);
    if (!words.after.empty()) absl::StrAppend(&out, " after \"", words.after, "\"");
    absl::StrAppend(&out, ": \"", absl::StrJoin(words.values, "\", \""), "\"");
  }
  return out;
}

// What stands under one heading.
struct Group {
  std::string title;
  std::vector<Entry> entries;
};

// "Expressions of `rules Msg` and `rules Graph`"
std::string TitleOf(EventClass event_class) {
  if (event_class == EventClass::kUniversal) return "Expressions of all rules";
  std::string out = "Expressions of";
  absl::string_view separator = " ";
  for (EventClass section : {EventClass::kMsg, EventClass::kGraph, EventClass::kExternal}) {
    if (!lang::Accepts(section, event_class)) continue;
    absl::StrAppend(&out, separator, "`rules ", lang::Name(section), "`");
    separator = " and ";
  }
  return out;
}

std::vector<Group> Grouped(const std::vector<Entry>& entries) {
  std::vector<Group> out;
  for (EventClass event_class :
       {EventClass::kUniversal, EventClass::kMsg, EventClass::kGraph, EventClass::kExternal}) {
    Group group{.title = TitleOf(event_class), .entries = {}};
    for (const Entry& entry : entries) {
      if (entry.kind != Entry::Kind::kAction && entry.event_class == event_class) {
        group.entries.push_back(entry);
      }
    }
    out.push_back(std::move(group));
  }
  out.push_back({.title = "Actions", .entries = {}});
  for (const Entry& entry : entries) {
    if (entry.kind == Entry::Kind::kAction) out.back().entries.push_back(entry);
  }
  std::erase_if(out, [](const Group& group) { return group.entries.empty(); });
  return out;
}

void PrintText(const std::vector<Entry>& entries, TextStream out) {
  const char* separator = "";
  for (const Group& group : Grouped(entries)) {
    out << separator << group.title << "\n";
    separator = "\n";
    Table table({"USAGE", "RESULT", "ADDED", "MEANING"});
    for (const Entry& entry : group.entries) {
      table.Add(
          {entry.usage, std::string(entry.result), entry.extension ? "yes" : "", HelpOf(entry)});
    }
    table.Print(out);
  }
}

std::string MarkdownCell(absl::string_view text) {
  return absl::StrReplaceAll(text, {{"|", "\\|"}, {"\n", " "}});
}

void PrintMarkdown(const std::vector<Entry>& entries, TextStream out) {
  const char* separator = "";
  for (const Group& group : Grouped(entries)) {
    out << separator << "## " << group.title << "\n\n";
    separator = "\n";
    out << "| usage | result | meaning |\n|---|---|---|\n";
    for (const Entry& entry : group.entries) {
      out << "| `" << MarkdownCell(entry.usage) << "` | " << entry.result << " | "
          << MarkdownCell(HelpOf(entry)) << (entry.extension ? " *(added)*" : "") << " |\n";
    }
  }
}

Json EntriesToJson(const std::vector<Entry>& entries) {
  Json out = Json::array();
  for (const Entry& entry : entries) {
    Json all_words = Json::array();
    for (const Words& words : entry.words) {
      Json one = {{"parameter", std::string(words.parameter)}};
      if (!words.after.empty()) one["after"] = std::string(words.after);
      one["values"] = std::vector<std::string>(words.values.begin(), words.values.end());
      all_words.push_back(std::move(one));
    }
    out.push_back({{"name", std::string(entry.name)},
                   {"kind", std::string(Name(entry.kind))},
                   {"class", std::string(lang::Name(entry.event_class))},
                   {"usage", entry.usage},
                   {"result", std::string(entry.result)},
                   {"help", std::string(entry.help)},
                   {"extension", entry.extension},
                   {"words", std::move(all_words)}});
  }
  return out;
}

class RulesBuiltinsCommand final : public Command {
 public:
  RulesBuiltinsCommand()
      : Command({"rules", "builtins",
                 "List the builtins, names and actions of the rule language; needs no server",
                 /*needs_server=*/false}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("NAME", name_, "Show only this name");
    app.add_flag("--markdown", markdown_, "Print Markdown, for a manual");
  }
  absl::StatusOr<ExitCode> Run(Env& env) override {
    if (markdown_ && env.json()) return UsageError(env, "choose --markdown or --output json");
    std::vector<Entry> entries = AllEntries();
    if (!name_.empty()) {
      std::vector<absl::string_view> names;
      for (const Entry& entry : entries) names.push_back(entry.name);
      std::erase_if(entries, [this](const Entry& entry) { return entry.name != name_; });
      if (entries.empty()) {
        const std::string hint = NearestHint(name_, names);
        return UsageError(env, absl::StrCat("the rule language has no `", name_, "`",
                                            hint.empty() ? "" : "; ", hint));
      }
    }
    if (env.json()) {
      PrintJson(EntriesToJson(entries), env.out);
    } else if (markdown_) {
      PrintMarkdown(entries, env.out);
    } else {
      PrintText(entries, env.out);
    }
    return ExitCode::kDone;
  }

 private:
  std::string name_;
  bool markdown_ = false;
};

}  // namespace

Commands RulesBuiltins() { return MakeCommands<RulesBuiltinsCommand>(); }

}  // namespace rips::ripsctl
