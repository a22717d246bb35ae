#include "policy_server/replay/rule_test_runner.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/lang/nearest.h"
#include "policy_server/lang/signature.h"
#include "policy_server/lang/type.h"
#include "policy_server/lang/value_text.h"
#include "policy_server/replay/replayer.h"

namespace rips::replay {
namespace {

using Values = absl::btree_map<std::string, lang::Value>;

// As the language writes it, or a level's name for its position; nullopt if it is no value of that
// type.
std::optional<lang::Value> ParseValue(const std::string& text, lang::ValueType type,
                                      const levels::LevelTable& levels) {
  int64_t integer = 0;
  double number = 0;
  switch (type) {
    case lang::ValueType::kInt:
    case lang::ValueType::kLevel:
      if (absl::SimpleAtoi(text, &integer)) return integer;
      if (const auto level = levels.Find(text)) return int64_t{*level};
      return std::nullopt;
    case lang::ValueType::kFloat:
      if (absl::SimpleAtod(text, &number)) return number;
      return std::nullopt;
    case lang::ValueType::kBool:
      if (text == "true" || text == "false") return text == "true";
      return std::nullopt;
    case lang::ValueType::kString:
      return text;
  }
  return std::nullopt;
}

// Finds the names and values of a file that its rules do not have.
class NameChecker {
 public:
  NameChecker(const RuleTestFile& file, const lang::CheckedRules& rules)
      : file_(file), rules_(rules), level_names_(rules.levels.names()) {
    for (const lang::TypedRule& rule : rules.rules) rule_names_.push_back(rule.name);
    for (const lang::Variable& variable : rules.variables) variable_names_.push_back(variable.name);
  }

  absl::Status Check() {
    if (!file_.start_level.text.empty()) Level(file_.start_level.line, file_.start_level.text);
    for (const RuleTest& test : file_.tests) {
      if (!test.start_level.text.empty()) Level(test.start_level.line, test.start_level.text);
      for (const std::string& level : test.trigger_fail) Level(test.trigger_fail_line, level);
      Variables(test.variables);
      for (const TestEvent& event : test.events) Expected(event.expect);
      Expected(test.expect);
    }
    if (problems_.empty()) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrJoin(problems_, "\n"));
  }

 private:
  void Problem(int line, const std::string& what) {
    problems_.push_back(absl::StrCat(file_.path, ":", line, ": ", what));
  }
  void Among(int line, absl::string_view kind, const std::string& name,
             const std::vector<std::string>& names) {
    if (std::find(names.begin(), names.end(), name) != names.end()) return;
    const std::vector<absl::string_view> views(names.begin(), names.end());
    const std::string hint = lang::NearestHint(name, views);
    Problem(line, absl::StrCat("the rules have no ", kind, " `", name, "`",
                               hint.empty() ? "" : "; ", hint));
  }
  void Level(int line, const std::string& name) { Among(line, "level", name, level_names_); }

  void Variables(const absl::btree_map<std::string, WantedText>& wanted) {
    for (const auto& [name, text] : wanted) {
      const auto found = std::find(variable_names_.begin(), variable_names_.end(), name);
      if (found == variable_names_.end()) {
        Among(text.line, "variable", name, variable_names_);
        continue;
      }
      const lang::ValueType type = rules_.variables[found - variable_names_.begin()].type;
      if (!ParseValue(text.text, type, rules_.levels).has_value()) {
        Problem(text.line, absl::StrCat("`", text.text, "` is no ", lang::Name(type),
                                        ", which the variable `", name, "` is"));
      }
    }
  }

  void List(const std::optional<WantedList>& list) {
    if (!list.has_value()) return;
    constexpr absl::string_view kResults[] = {"decided", "refused", "ok", "failed"};
    for (const WantedEntry& entry : list->entries) {
      for (const auto& [field, text] : entry.fields) {
        if (field == "rule") Among(list->line, "rule", text, rule_names_);
        if (field == "from" || field == "to") Level(list->line, text);
        if (field == "program") Among(list->line, "program", text, rules_.programs);
        if (field == "severity") Word(list->line, field, text, lang::Severities());
        if (field == "result") Word(list->line, field, text, kResults);
      }
    }
  }
  void Word(int line, const std::string& field, const std::string& text,
            std::span<const absl::string_view> words) {
    if (std::find(words.begin(), words.end(), text) != words.end()) return;
    Problem(line, absl::StrCat("`", text, "` is no ", field, "; write `",
                               absl::StrJoin(words, "` or `"), "`"));
  }

  void Expected(const Expectation& expect) {
    for (const auto* list :
         {&expect.alerts, &expect.transitions, &expect.execs, &expect.faults, &expect.fired}) {
      List(*list);
    }
    if (expect.level.has_value()) Level(expect.level->line, expect.level->text);
    Variables(expect.variables);
  }

  const RuleTestFile& file_;
  const lang::CheckedRules& rules_;
  std::vector<std::string> level_names_;
  std::vector<std::string> rule_names_;
  std::vector<std::string> variable_names_;
  std::vector<std::string> problems_;
};

WantedEntry EntryOf(const Alerted& alert) {
  return {.fields = {{"rule", alert.rule},
                     {"text", alert.text},
                     {"severity", std::string(engine::ToString(alert.severity))}}};
}
WantedEntry EntryOf(const Changed& change) {
  return {.fields = {{"rule", change.rule},
                     {"from", change.from},
                     {"to", change.to},
                     {"result", change.refused ? "refused" : "decided"}}};
}
WantedEntry EntryOf(const Executed& exec) {
  return {.fields = {{"rule", exec.rule},
                     {"program", exec.program},
                     {"result", exec.ok ? "ok" : "failed"}},
          .args = exec.args};
}
WantedEntry EntryOf(const Noted& note) {
  return {.fields = {{"rule", note.rule}, {"text", note.text}}};
}

template <typename Record>
std::vector<WantedEntry> Entries(const std::vector<Record>& records, size_t begin) {
  std::vector<WantedEntry> out;
  for (size_t i = begin; i < records.size(); ++i) out.push_back(EntryOf(records[i]));
  return out;
}

bool Matches(const WantedEntry& wanted, const WantedEntry& got) {
  if (wanted.args.has_value() && wanted.args != got.args) return false;
  return std::all_of(wanted.fields.begin(), wanted.fields.end(),
                     [&](const auto& field) { return got.fields.at(field.first) == field.second; });
}

std::vector<std::string> Show(const std::vector<WantedEntry>& entries) {
  std::vector<std::string> lines;
  for (const WantedEntry& entry : entries) {
    std::vector<std::string> parts;
    for (const auto& [field, text] : entry.fields) parts.push_back(absl::StrCat(field, ": ", text));
    if (entry.args.has_value()) {
      parts.push_back(absl::StrCat("args: [", absl::StrJoin(*entry.args, ", "), "]"));
    }
    lines.push_back(parts.empty() ? "(any)" : absl::StrJoin(parts, ", "));
  }
  if (lines.empty()) lines.push_back("(none)");
  return lines;
}

// One test.
class Runner {
 public:
  Runner(const RuleTestFile& file, const RuleTest& test, const RuleSet& rules)
      : test_(test),
        rules_(rules.program->rules()),
        session_(rules.NewSession()),
        replayer_(rules.program, Options(file, test, rules_.levels), session_.get()) {
    Values values;
    for (const auto& [name, text] : test.variables) values[name] = *ParseAs(name, text.text);
    replayer_.SetVariables(values);
    const Values taken = replayer_.variables();
    for (const auto& [name, text] : test.variables) {
      if (taken.at(name) == values[name]) continue;
      Fail(text.line, absl::StrCat("initial value of `", name, "`"), {text.text},
           {"the variable does not take it: it names no level, or is too long"});
    }
  }

  TestOutcome Run() {
    const Before start = Mark();
    for (size_t i = 0; i < test_.events.size(); ++i) {
      const TestEvent& event = test_.events[i];
      const Before before = Mark();
      if (!Happen(i, event)) break;
      Check(event.expect, before, "");
    }
    Check(test_.expect, start, " at the end");
    if (replayer_.so_far().left_out > 0) {
      Fail(test_.line, "number of alerts, transitions, execs and faults",
           {absl::StrCat("at most ", ReplayOptions().records_max)}, {"more"});
    }
    return {.name = test_.name, .line = test_.line, .failures = std::move(failures_)};
  }
  const std::vector<RuleHits>& hits() const { return replayer_.so_far().rules; }

 private:
  // How much had happened.
  struct Before {
    size_t alerts = 0;
    size_t transitions = 0;
    size_t execs = 0;
    size_t faults = 0;
    std::vector<uint64_t> fired;
  };

  static ReplayOptions Options(const RuleTestFile& file, const RuleTest& test,
                               const levels::LevelTable& levels) {
    const std::string& start =
        test.start_level.text.empty() ? file.start_level.text : test.start_level.text;
    ReplayOptions options{.start_level = levels.Find(start).value_or(0), .robot = file.robot};
    options.failing_programs.insert(test.exec_fail.begin(), test.exec_fail.end());
    for (const std::string& level : test.trigger_fail) {
      options.failing_levels.insert(levels.Find(level).value_or(0));
    }
    return options;
  }

  std::optional<lang::Value> ParseAs(const std::string& name, const std::string& text) const {
    for (const lang::Variable& variable : rules_.variables) {
      if (variable.name == name) return ParseValue(text, variable.type, rules_.levels);
    }
    return std::nullopt;
  }

  // False if the test cannot go on.
  bool Happen(size_t index, const TestEvent& event) {
    if (std::holds_alternative<WaitSpec>(event.what)) {
      time_ns_ += event.every_ns;
      return true;
    }
    for (int64_t i = 0; i < event.repeat; ++i, time_ns_ += event.every_ns) {
      if (std::holds_alternative<TickSpec>(event.what)) {
        replayer_.JudgeTick(index, time_ns_);
        continue;
      }
      recording::Recorded recorded{.index = index, .time_unix_ns = time_ns_};
      std::visit(
          [&](const auto& what) {
            using What = std::decay_t<decltype(what)>;
            if constexpr (!std::is_same_v<What, TickSpec> && !std::is_same_v<What, WaitSpec>) {
              recorded.what = what;
            }
          },
          event.what);
      const absl::Status judged = replayer_.Judge(recorded);
      if (judged.ok()) continue;
      Fail(event.line, "the event itself", {"it can be judged"}, {std::string(judged.message())});
      return false;
    }
    return true;
  }

  Before Mark() const {
    const Result& so_far = replayer_.so_far();
    Before out{.alerts = so_far.alerts.size(),
               .transitions = so_far.transitions.size(),
               .execs = so_far.execs.size(),
               .faults = so_far.faults.size()};
    for (const RuleHits& rule : so_far.rules) out.fired.push_back(rule.fired);
    return out;
  }

  void Check(const Expectation& expect, const Before& before, absl::string_view when) {
    const Result& now = replayer_.so_far();
    if (expect.fired.has_value()) {
      std::vector<WantedEntry> fired;
      for (size_t i = 0; i < now.rules.size(); ++i) {
        if (now.rules[i].fired == before.fired[i]) continue;
        fired.push_back({.fields = {{"rule", now.rules[i].name}}});
      }
      CheckList("fired", expect.fired, fired, when);
    }
    CheckList("alerts", expect.alerts, Entries(now.alerts, before.alerts), when);
    CheckList("transitions", expect.transitions, Entries(now.transitions, before.transitions),
              when);
    CheckList("execs", expect.execs, Entries(now.execs, before.execs), when);
    CheckList("faults", expect.faults, Entries(now.faults, before.faults), when);
    if (expect.level.has_value() && expect.level->text != replayer_.level()) {
      Fail(expect.level->line, absl::StrCat("level", when), {expect.level->text},
           {replayer_.level()});
    }
    const Values values = replayer_.variables();
    for (const auto& [name, wanted] : expect.variables) {
      const std::string text = lang::ToText(*ParseAs(name, wanted.text));
      const std::string got = lang::ToText(values.at(name));
      if (text == got) continue;
      Fail(wanted.line, absl::StrCat("variable `", name, "`", when), {text}, {got});
    }
  }

  void CheckList(absl::string_view what, const std::optional<WantedList>& wanted,
                 const std::vector<WantedEntry>& got, absl::string_view when) {
    if (!wanted.has_value()) return;
    const std::vector<WantedEntry>& entries = wanted->entries;
    if (std::equal(entries.begin(), entries.end(), got.begin(), got.end(), Matches)) return;
    Fail(wanted->line, absl::StrCat(what, when), Show(entries), Show(got));
  }

  void Fail(int line, std::string what, std::vector<std::string> expected,
            std::vector<std::string> got) {
    failures_.push_back({.line = line,
                         .what = std::move(what),
                         .expected = std::move(expected),
                         .got = std::move(got)});
  }

  const RuleTest& test_;
  const lang::CheckedRules& rules_;
  const std::unique_ptr<inspect::Session> session_;
  Replayer replayer_;
  int64_t time_ns_ = 0;
  std::vector<TestFailure> failures_;
};

}  // namespace

absl::StatusOr<FileOutcome> RunRuleTests(const RuleTestFile& file, const RuleSet& rules) {
  const lang::CheckedRules& checked = rules.program->rules();
  const absl::Status names = NameChecker(file, checked).Check();
  if (!names.ok()) return names;
  FileOutcome out;
  std::vector<uint64_t> fired(checked.rules.size());
  for (const RuleTest& test : file.tests) {
    Runner runner(file, test, rules);
    out.tests.push_back(runner.Run());
    for (size_t i = 0; i < fired.size(); ++i) fired[i] += runner.hits()[i].fired;
  }
  for (size_t i = 0; i < fired.size(); ++i) {
    if (fired[i] == 0) out.not_exercised.push_back(checked.rules[i].name);
  }
  return out;
}

}  // namespace rips::replay
