#include "policy_server/policy/replay/rule_test_runner.h"

#include <algorithm>
#include <optional>
#include <set>
#include <string>
#include <type_traits>
#include <utility>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/lang/check/signature.h"
#include "policy_server/policy/lang/check/type.h"
#include "policy_server/policy/lang/value_text.h"
#include "policy_server/policy/replay/replayer.h"
#include "policy_server/policy/replay/rule_facts.h"
#include "services/text/nearest.h"

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

// Why a transition is refused.
const std::vector<absl::string_view>& Reasons() {
  using levels::Refusal;
  static const auto& reasons = *new std::vector<absl::string_view>{
      levels::ToString(Refusal::kNeedsOperator), levels::ToString(Refusal::kBlind),
      levels::ToString(Refusal::kBudget), levels::ToString(Refusal::kNotLower),
      levels::ToString(Refusal::kNotHigher)};
  return reasons;
}

// Finds the names and values of a file that its rules do not have.
class NameChecker {
 public:
  NameChecker(const RuleTestFile& file, const RuleSet& set)
      : file_(file),
        of_bundle_(!set.bundle_id.empty()),
        rules_(set.program->rules()),
        level_names_(rules_.levels.names()) {
    for (const lang::TypedRule& rule : rules_.rules) rule_names_.push_back(rule.name);
    for (const lang::Variable& each : rules_.variables) variable_names_.push_back(each.name);
  }

  absl::Status Check() {
    if (of_bundle_ && file_.options_line > 0) {
      Problem(file_.options_line,
              "the manifest of the bundle sets `dialect` and `on_inspection_error`; remove them "
              "here");
    }
    if (!file_.start_level.text.empty()) Level(file_.start_level.line, file_.start_level.text);
    for (const RuleTest& test : file_.tests) {
      if (!test.start_level.text.empty()) Level(test.start_level.line, test.start_level.text);
      for (const std::string& level : test.trigger_fail) Level(test.trigger_fail_line, level);
      for (const std::string& program : test.exec_fail) {
        Among(test.exec_fail_line, "program", program, rules_.programs);
      }
      Variables(test.variables);
      for (const TestEvent& event : test.events) {
        if (const auto* order = std::get_if<OrderSpec>(&event.what)) {
          Level(order->level.line, order->level.text);
        }
        Expected(event.expect);
      }
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
    const std::string hint = NearestHint(name, views);
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

  void List(const std::optional<WantedList>& list, bool of_transitions) {
    if (!list.has_value()) return;
    constexpr absl::string_view kResults[] = {"decided", "refused", "ok", "failed"};
    for (const WantedEntry& entry : list->entries) {
      for (const auto& [field, text] : entry.fields) {
        const bool somebody = of_transitions && text == kOperatorName;
        if (field == "rule" && !somebody) Among(list->line, "rule", text, rule_names_);
        if (field == "reason") Word(list->line, field, text, Reasons());
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
    for (const auto* list : {&expect.alerts, &expect.transitions, &expect.execs, &expect.faults,
                             &expect.fired, &expect.unscanned}) {
      List(*list, list == &expect.transitions);
    }
    if (expect.level.has_value()) Level(expect.level->line, expect.level->text);
    Variables(expect.variables);
  }

  const RuleTestFile& file_;
  const bool of_bundle_;
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
  WantedEntry entry{.fields = {{"rule", change.rule},
                               {"from", change.from},
                               {"to", change.to},
                               {"result", change.refused ? "refused" : "decided"}}};
  if (change.refused) entry.fields["reason"] = change.reason;
  return entry;
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
  return std::all_of(wanted.fields.begin(), wanted.fields.end(), [&](const auto& field) {
    const auto found = got.fields.find(field.first);
    return found != got.fields.end() && found->second == field.second;
  });
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
        set_(rules),
        rules_(rules.program->rules()),
        fires_unscanned_(rules.program->options().on_inspection_error ==
                         engine::OnInspectionError::kMatch),
        evidence_complete_(test.evidence_complete),
        session_(rules.NewSession()),
        replayer_(rules.program, Options(file, test, rules), session_.get()) {
    replayer_.SetEvidence(evidence_complete_);
    TellFindings();
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
    start_ = SoFar();
    std::vector<uint64_t> meant(rules_.rules.size());
    for (size_t i = 0; i < test_.events.size(); ++i) {
      const TestEvent& event = test_.events[i];
      const Before before = SoFar();
      if (!Happen(i, event)) break;
      Check(event.expect, before, "");
      if (event.expect.unscanned.has_value()) AddUnscanned(before, meant);
    }
    Check(test_.expect, start_, " at the end");
    if (test_.expect.unscanned.has_value()) meant = SoFar().unscanned;
    if (replayer_.so_far().left_out > 0) {
      Fail(test_.line, "number of alerts, transitions, execs and faults",
           {absl::StrCat("at most ", ReplayOptions().records_max)}, {"more"});
    }
    return {.name = test_.name,
            .line = test_.line,
            .failures = std::move(failures_),
            .unscanned = RulesSince(meant, &RuleHits::unscanned)};
  }
  const std::vector<RuleHits>& hits() const { return replayer_.so_far().rules; }

 private:
  // How much had happened.
  struct Before {
    size_t alerts = 0;
    size_t transitions = 0;
    size_t execs = 0;
    size_t faults = 0;
    // By rule.
    std::vector<uint64_t> fired;
    std::vector<uint64_t> unscanned;
  };

  static ReplayOptions Options(const RuleTestFile& file, const RuleTest& test,
                               const RuleSet& rules) {
    const levels::LevelTable& levels = rules.program->rules().levels;
    const std::string& start =
        test.start_level.text.empty() ? file.start_level.text : test.start_level.text;
    ReplayOptions options{.start_level = levels.Find(start).value_or(rules.start_level),
                          .robot = file.robot};
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
    for (int64_t i = 0; i < event.repeat; ++i) {
      const absl::Status judged =
          std::visit([&](const auto& what) { return HappenOnce(index, what); }, event.what);
      if (!judged.ok()) {
        Fail(event.line, "the event itself", {"it can be judged"}, {std::string(judged.message())});
        return false;
      }
      time_ns_ =
          event.every_ns > kTimeNsMax - time_ns_ ? kTimeNsMax + 1 : time_ns_ + event.every_ns;
    }
    return true;
  }

  absl::Status HappenOnce(size_t, const WaitSpec&) { return absl::OkStatus(); }
  absl::Status HappenOnce(size_t, const EvidenceSpec& evidence) {
    if (evidence.complete && evidence_complete_) return absl::OkStatus();
    evidence_complete_ = evidence.complete;
    TellFindings();
    held_at_ns_ = time_ns_ + set_.soft_hold_ns;
    replayer_.SetEvidence(evidence.complete && set_.soft_hold_ns == 0);
    return absl::OkStatus();
  }
  absl::Status HappenOnce(size_t, const FindingOverSpec& over) {
    const auto found = findings_.find(over.kind);
    if (found == findings_.end()) {
      return absl::InvalidArgumentError(absl::StrCat("no finding `", over.kind, "` stands"));
    }
    findings_.erase(found);
    TellFindings();
    return absl::OkStatus();
  }
  void TellFindings() {
    engine::StandingFindings standing(/*told_all=*/evidence_complete_);
    for (const std::string& kind : findings_) standing.Add(kind);
    replayer_.SetFindings(standing);
  }
  // Rules may lower again once the evidence has been complete for the bundle's soft_hold.
  void UpdateEvidence() {
    if (evidence_complete_ && time_ns_ >= held_at_ns_) replayer_.SetEvidence(true);
  }
  absl::Status HappenOnce(size_t index, const TickSpec&) {
    if (time_ns_ > kTimeNsMax) return TooLate();
    UpdateEvidence();
    replayer_.JudgeTick(index, time_ns_);
    return absl::OkStatus();
  }
  absl::Status HappenOnce(size_t index, const OrderSpec& order) {
    if (time_ns_ > kTimeNsMax) return TooLate();
    if (WaitsForApproval(order)) return absl::OkStatus();
    replayer_.Order(index, time_ns_, order.raise, rules_.levels.Find(order.level.text).value_or(0));
    return absl::OkStatus();
  }
  // A lowering from or past a level of the bundle's `two_person` that no second operator approves.
  bool WaitsForApproval(const OrderSpec& order) const {
    if (order.raise || order.approved) return false;
    const auto to = rules_.levels.Find(order.level.text).value_or(0);
    const auto from = rules_.levels.Find(replayer_.level()).value_or(0);
    return std::any_of(set_.two_person.begin(), set_.two_person.end(), [&](const auto& name) {
      const auto level = rules_.levels.Find(name);
      return level.has_value() && *level > to && *level <= from;
    });
  }
  template <typename What>
  absl::Status HappenOnce(size_t index, const What& what) {
    UpdateEvidence();
    if constexpr (std::is_same_v<What, model::ExternalEvent>) {
      if (const auto* finding = std::get_if<model::Finding>(&what)) {
        findings_.insert(finding->kind);
        TellFindings();
      }
    }
    recording::Recorded recorded{.index = index, .time_unix_ns = time_ns_};
    recorded.what = what;
    return replayer_.Judge(recorded);
  }
  static absl::Status TooLate() {
    return absl::InvalidArgumentError("it would happen after the year 2115");
  }

  Before SoFar() const {
    const Result& so_far = replayer_.so_far();
    Before out{.alerts = so_far.alerts.size(),
               .transitions = so_far.transitions.size(),
               .execs = so_far.execs.size(),
               .faults = so_far.faults.size()};
    for (const RuleHits& rule : so_far.rules) {
      out.fired.push_back(rule.fired);
      out.unscanned.push_back(rule.unscanned);
    }
    return out;
  }

  // Names of the rules whose `count` is not what it was `before`.
  std::vector<std::string> RulesSince(const std::vector<uint64_t>& before,
                                      uint64_t RuleHits::*count) const {
    std::vector<std::string> names;
    for (size_t i = 0; i < hits().size(); ++i) {
      if (hits()[i].*count != before[i]) names.push_back(hits()[i].name);
    }
    return names;
  }
  void AddUnscanned(const Before& before, std::vector<uint64_t>& to) const {
    for (size_t i = 0; i < to.size(); ++i) to[i] += hits()[i].unscanned - before.unscanned[i];
  }

  std::string NoteSince(const Before& before) const {
    const std::vector<std::string> rules = RulesSince(before.unscanned, &RuleHits::unscanned);
    if (rules.empty()) return "";
    return absl::StrCat("an inspection could not tell, so these rules ",
                        fires_unscanned_ ? "fired" : "did not fire", ": ",
                        absl::StrJoin(rules, ", "));
  }

  void Check(const Expectation& expect, const Before& before, absl::string_view when) {
    const Result& now = replayer_.so_far();
    note_ = NoteSince(before);
    CheckList("fired", expect.fired, Rules(before.fired, &RuleHits::fired), when);
    CheckList("alerts", expect.alerts, Entries(now.alerts, before.alerts), when);
    CheckList("transitions", expect.transitions, Entries(now.transitions, before.transitions),
              when);
    CheckList("execs", expect.execs, Entries(now.execs, before.execs), when);
    CheckList("faults", expect.faults, Entries(now.faults, before.faults), when);
    note_ = "";
    CheckList("unscanned", expect.unscanned, Rules(before.unscanned, &RuleHits::unscanned), when);

    // These may be as they are since long ago.
    note_ = NoteSince(start_);
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
    note_ = "";
  }

  std::vector<WantedEntry> Rules(const std::vector<uint64_t>& before,
                                 uint64_t RuleHits::*count) const {
    std::vector<WantedEntry> out;
    for (std::string& name : RulesSince(before, count)) {
      out.push_back({.fields = {{"rule", std::move(name)}}});
    }
    return out;
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
                         .got = std::move(got),
                         .note = note_});
  }

  const RuleTest& test_;
  const RuleSet& set_;
  const lang::CheckedRules& rules_;
  // Rules that an inspection could not tell.
  const bool fires_unscanned_;
  bool evidence_complete_;
  // Kinds of those that stand.
  std::multiset<std::string> findings_;
  // When evidence that is complete has been so for long enough.
  int64_t held_at_ns_ = 0;
  const std::unique_ptr<inspect::Session> session_;
  Replayer replayer_;
  int64_t time_ns_ = kTestStartNs;
  Before start_;
  // Of failures that are found now.
  std::string note_;
  std::vector<TestFailure> failures_;
};

}  // namespace

absl::StatusOr<FileOutcome> RunRuleTests(const RuleTestFile& file, const RuleSet& rules) {
  const lang::CheckedRules& checked = rules.program->rules();
  const absl::Status names = NameChecker(file, rules).Check();
  if (!names.ok()) return names;
  FileOutcome out;
  std::vector<uint64_t> fired(checked.rules.size());
  for (const RuleTest& test : file.tests) {
    Runner runner(file, test, rules);
    out.tests.push_back(runner.Run());
    for (size_t i = 0; i < fired.size(); ++i) fired[i] += runner.hits()[i].fired;
  }
  for (size_t i = 0; i < fired.size(); ++i) {
    if (fired[i] == 0 && !NeverFires(checked.rules[i]))
      out.not_exercised.push_back(checked.rules[i].name);
  }
  return out;
}

}  // namespace rips::replay
