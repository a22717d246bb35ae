// `ripsctl rules replay`: runs rules on a recording. JSON is that of
// policy_server/policy/replay/result_json.h; with `--against` it has `"against"`, the difference to
// what the other rules do. Exits with kDone when it ran, kIncomplete when it ran on what is left of
// a recording that is cut, damaged or lacks a file, kRefused for rules that do not compile (with
// the output of `rules check`), kUsage for what cannot be read and for levels that the rules do not
// have; then nothing is printed but the error.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "policy_server/policy/lang/check/type.h"
#include "policy_server/policy/lang/value_text.h"
#include "policy_server/policy/recording/reader.h"
#include "policy_server/policy/replay/replayer.h"
#include "policy_server/policy/replay/result_json.h"
#include "policy_server/policy/replay/rule_facts.h"
#include "policy_server/policy/replay/rule_set.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/commands.h"
#include "services/base/cut_text.h"
#include "services/base/status_macros.h"
#include "services/runtime/real_clock.h"

namespace rips::ripsctl {
namespace {

using replay::Result;
using replay::RuleSet;

// An hour.
constexpr int64_t kMillisMax = 3'600'000;

// `12 +0.345s` in a recording without times, `12 2026-01-01T00:00:00.345Z` in one that has them.
std::string MomentText(const replay::Moment& at, bool timed) {
  const std::string time = timed ? ShortTime(at.time_ns)
                                 : absl::StrFormat("+%d.%03ds", at.time_ns / kNanosPerSecond,
                                                   at.time_ns % kNanosPerSecond / kNanosPerMilli);
  return absl::StrCat(at.event, " ", time);
}

std::string CommandLine(const replay::Executed& exec) {
  return exec.args.empty() ? exec.program
                           : absl::StrCat(exec.program, " ", absl::StrJoin(exec.args, " "));
}

std::vector<std::string> Row(const replay::Alerted& alert, bool timed) {
  return {MomentText(alert.at, timed), std::string(engine::ToString(alert.severity)), alert.rule,
          alert.text};
}
std::vector<std::string> Row(const replay::Changed& change, bool timed) {
  return {MomentText(change.at, timed), change.from, change.to,
          change.refused ? absl::StrCat("refused: ", change.reason) : "decided", change.rule};
}
std::vector<std::string> Row(const replay::Executed& exec, bool timed) {
  return {MomentText(exec.at, timed), exec.ok ? "ok" : "failed", exec.rule, CommandLine(exec)};
}
std::vector<std::string> Row(const replay::Noted& note, bool timed) {
  return {MomentText(note.at, timed), note.rule, note.text};
}

template <typename Record>
void PrintTable(absl::string_view title, std::vector<std::string> header,
                const std::vector<Record>& records, bool timed, TextStream out) {
  if (records.empty()) return;
  out << "\n" << title << "\n";
  Table table(std::move(header));
  for (const Record& record : records) table.Add(Row(record, timed));
  table.Print(out);
}

const std::vector<std::string> kAlertHeader = {"EVENT", "SEVERITY", "RULE", "TEXT"};
const std::vector<std::string> kChangeHeader = {"EVENT", "FROM", "TO", "RESULT", "RULE"};
const std::vector<std::string> kExecHeader = {"EVENT", "RESULT", "RULE", "COMMAND"};
const std::vector<std::string> kNoteHeader = {"EVENT", "RULE", "TEXT"};

void PrintHits(const Result& result, bool profile, TextStream out) {
  std::vector<replay::RuleHits> rules = result.rules;
  std::stable_sort(rules.begin(), rules.end(),
                   [](const auto& a, const auto& b) { return a.fired > b.fired; });
  out << "\nRules, those that fired most first\n";
  std::vector<std::string> header = {"FIRED", "OF", "SECTION", "RULE"};
  if (profile) header.insert(header.begin() + 2, "NS");
  Table table(header);
  for (const replay::RuleHits& rule : rules) {
    std::vector<std::string> row = {absl::StrCat(rule.fired), absl::StrCat(rule.evaluated),
                                    std::string(lang::Name(rule.section)), rule.name};
    if (profile) row.insert(row.begin() + 2, absl::StrCat(rule.mean_ns()));
    table.Add(std::move(row));
  }
  table.Print(out);
}

// Up to five of the rules whose `count` is not 0.
std::string SomeRules(const Result& result, uint64_t replay::RuleHits::*count) {
  constexpr size_t kShown = 5;
  std::vector<std::string> names;
  for (const replay::RuleHits& rule : result.rules) {
    if (rule.*count > 0) names.push_back(EscapeText(rule.name));
  }
  const size_t more = names.size() > kShown ? names.size() - kShown : 0;
  names.resize(names.size() - more);
  return absl::StrCat(absl::StrJoin(names, ", "),
                      more > 0 ? absl::StrCat(" and ", more, " more") : "");
}

// `cut after 12.4 s (event 311, 2026-01-01T00:00:12.400Z): ...`
std::string MissingText(const replay::Missing& missing, bool timed) {
  std::string place = missing.end ? "cut" : "part missing";
  if (!missing.after.has_value()) {
    place += " at its beginning";
  } else if (timed) {
    absl::StrAppendFormat(&place, " after %.1f s (event %d, %s)",
                          static_cast<double>(missing.after_ns) / kNanosPerSecond,
                          missing.after->event, ShortTime(missing.after->time_ns));
  } else {
    absl::StrAppend(&place, " after event ", missing.after->event);
  }
  return absl::StrCat(place, ": ", EscapeText(missing.text));
}

// What the recording or the robot did not tell. Nothing, if all was told.
void PrintNotTold(const Result& result, const RuleSet& rules, TextStream out) {
  const replay::EventCounts& events = result.events;
  if (events.undecidable > 0) {
    out << "undecidable: at " << events.undecidable << " events a rule asked what the recording "
        << "does not hold, so it did not fire: "
        << SomeRules(result, &replay::RuleHits::undecidable) << "\n";
  }
  uint64_t unscanned = 0;
  uint64_t truncated = 0;
  for (const replay::RuleHits& rule : result.rules) {
    unscanned += rule.unscanned - rule.graph_truncated;
    truncated += rule.graph_truncated;
  }
  const char* then =
      rules.program->options().on_inspection_error == engine::OnInspectionError::kMatch
          ? "fired all the same"
          : "did not fire";
  if (unscanned > 0) {
    out << "unscanned: " << unscanned
        << " times a rule asked an inspection that could not tell; it " << then
        << " (see --on-inspection-error): " << SomeRules(result, &replay::RuleHits::unscanned)
        << "\n";
  }
  if (truncated > 0) {
    out << "graph truncated: " << truncated
        << " times a rule asked for what was left out of the graph; it " << then << ": "
        << SomeRules(result, &replay::RuleHits::graph_truncated) << "\n";
  }
  if (events.unattributed > 0 && replay::AsksWhoSent(rules.program->rules())) {
    const bool no_writers = events.unattributed_writer == events.unattributed;
    out << "no sender: " << events.unattributed << " messages do not say who sent them; "
        << (no_writers ? "`senderin` and `sendercount` are" : "`senderin` is")
        << " false for them\n";
  }
}

void PrintResult(const Result& result, const RuleSet& rules, bool profile, TextStream out) {
  const replay::EventCounts& events = result.events;
  out << "events: " << events.message << " messages, " << events.graph << " graph changes, "
      << events.external << " external\nlevel at the end: " << EscapeText(result.level) << "\n";
  for (const replay::Missing& missing : result.missing) {
    out << "incomplete recording: " << MissingText(missing, result.timed) << "\n";
  }
  PrintNotTold(result, rules, out);
  if (result.crashed.has_value()) {
    out << "crashed: a rule called `crash` at event " << MomentText(*result.crashed, result.timed)
        << "; no rule ran afterwards\n";
  }
  if (result.left_out > 0) {
    out << "left out: " << result.left_out << " more entries than the lists below may hold\n";
  }
  PrintTable("Levels", kChangeHeader, result.transitions, result.timed, out);
  PrintTable("Alerts", kAlertHeader, result.alerts, result.timed, out);
  PrintTable("Programs", kExecHeader, result.execs, result.timed, out);
  PrintTable("Faults", kNoteHeader, result.faults, result.timed, out);
  PrintTable("True and False", kNoteHeader, result.logs, result.timed, out);
  if (!result.variables.empty()) {
    out << "\nVariables at the end\n";
    Table table({"NAME", "VALUE"});
    for (const auto& [name, value] : result.variables) table.Add({name, lang::ToText(value)});
    table.Print(out);
  }
  if (!result.rules.empty()) PrintHits(result, profile, out);
}

template <typename Record>
void PrintBoth(const std::string& title, const std::vector<std::string>& header,
               const replay::OnlyOne<Record>& only, bool timed, TextStream out) {
  PrintTable(absl::StrCat(title, " of --rules only"), header, only.before, timed, out);
  PrintTable(absl::StrCat(title, " of --against only"), header, only.after, timed, out);
}

void PrintVariables(const replay::Difference& difference, TextStream out) {
  if (difference.variables_before.empty() && difference.variables_after.empty()) return;
  std::set<std::string> names;
  for (const auto* values : {&difference.variables_before, &difference.variables_after}) {
    for (const auto& [name, value] : *values) names.insert(name);
  }
  const auto text_in = [](const auto& values, const std::string& name) {
    const auto found = values.find(name);
    return found == values.end() ? "(none)" : lang::ToText(found->second);
  };
  out << "\nVariables that differ at the end\n";
  Table table({"NAME", "WITH --rules", "WITH --against"});
  for (const std::string& name : names) {
    table.Add({name, text_in(difference.variables_before, name),
               text_in(difference.variables_after, name)});
  }
  table.Print(out);
}

void PrintDifference(const replay::Difference& difference, bool timed, TextStream out) {
  if (difference.left_out) {
    out << "\nagainst: lists were cut; what was left out of them is not compared";
  }
  if (difference.none()) {
    out << "\nagainst: the same levels, alerts, programs and variables\n";
    return;
  }
  out << "\nagainst: the other rules differ";
  if (difference.first.has_value()) {
    out << " from event " << MomentText(*difference.first, timed) << " on";
  }
  out << "; level at the end: " << EscapeText(difference.level_before) << " with --rules, "
      << EscapeText(difference.level_after) << " with --against\n";
  PrintBoth("Levels", kChangeHeader, difference.transitions, timed, out);
  PrintBoth("Alerts", kAlertHeader, difference.alerts, timed, out);
  PrintBoth("Programs", kExecHeader, difference.execs, timed, out);
  PrintVariables(difference, out);
}

// The event at which the rules raise that recorded alert; nullopt = they do not.
std::optional<replay::Moment> CameAgain(const recording::RecordedAlert& recorded,
                                        const Result& result) {
  for (const replay::Alerted& each : result.alerts) {
    const bool same =
        each.rule == recorded.rule &&
        Shortened(each.text, recording::RecordedAlert::kTextBytesMax) == recorded.text;
    if (same) return each.at;
  }
  return std::nullopt;
}

void PrintRecorded(const std::vector<recording::RecordedAlert>& recorded, const Result& result,
                   TextStream out) {
  if (recorded.empty()) return;
  out << "\nAlerts that it was recorded with\n";
  Table table({"ID", "RULE", "IN THIS REPLAY", "TEXT"});
  bool missed = false;
  for (const recording::RecordedAlert& each : recorded) {
    const std::optional<replay::Moment> at = CameAgain(each, result);
    const bool own = each.rule == "(rips)";
    missed |= !own && !at.has_value();
    table.Add({ShortId(each.id), each.rule,
               own              ? "RIPS's own: no rule raises it"
               : at.has_value() ? absl::StrCat("at event ", MomentText(*at, result.timed))
                                : "not raised",
               each.text});
  }
  table.Print(out);
  if (missed) {
    out << "what may keep one from coming again: other rules; messages before the recording that "
           "were counted;\na program that failed or a level that was not reached (--exec-fail, "
           "--trigger-fail)\n";
  }
}

Json RecordedJson(const std::vector<recording::RecordedAlert>& recorded, const Result& result) {
  Json out = Json::array();
  for (const recording::RecordedAlert& each : recorded) {
    const std::optional<replay::Moment> at = CameAgain(each, result);
    Json event;
    if (at.has_value()) event = at->event;
    out.push_back(
        {{"id", each.id}, {"rule", each.rule}, {"text", each.text}, {"event", std::move(event)}});
  }
  return out;
}

class ReplayRulesCommand final : public Command {
 public:
  ReplayRulesCommand()
      : Command({"rules", "replay",
                 "Run rules on a recording and show what they do; needs no server",
                 /*needs_server=*/false}) {}
  void AddFlags(CLI::App& app) override {
    app.add_option("--rules", rules_,
                   "Rule files, compiled as one policy in this order, or the directory of a bundle")
        ->required();
    app.add_option(
           "--events", events_,
           "Recording: a file of `ripsctl record`, a rosbag2 bag or file, or YAML of the prototype")
        ->required();
    app.add_option("--against", against_,
                   "Other rule files, or another bundle; show how their results differ");
    app.add_option("--dialect", dialect_, "Dialect of the rules: what the include forms mean")
        ->check(CLI::IsMember({"rips", "prototype"}))
        ->capture_default_str();
    app.add_option(
        "--start-level", start_level_,
        "Level before the first event; default: the recording's, else the bundle's, else "
        "the first");
    app.add_option("--virtual-tick", tick_ms_, "External tick every N ms; 0 = none")
        ->check(CLI::Range(int64_t{0}, kMillisMax))
        ->capture_default_str();
    app.add_option("--event-interval", interval_ms_,
                   "Milliseconds between events when the recording has no times")
        ->check(CLI::Range(int64_t{0}, kMillisMax))
        ->capture_default_str();
    app.add_option("--exec-fail", exec_fail_, "Programs to simulate as failing");
    app.add_option("--trigger-fail", trigger_fail_, "Levels to simulate as not reached");
    app.add_option("--on-inspection-error", on_inspection_error_,
                   "How to treat a rule whose payload or plugin check gives no verdict")
        ->check(CLI::IsMember({"match", "alert", "ignore"}))
        ->capture_default_str();
    app.add_flag("--profile", profile_, "Print the cost of each rule");
  }

  absl::StatusOr<ExitCode> Run(Env& env) override {
    absl::StatusOr<RuleSet> rules = Load(rules_);
    if (!rules.ok()) return UsageError(env, rules.status().message());
    absl::StatusOr<RuleSet> other = RuleSet{};
    if (!against_.empty()) other = Load(against_);
    if (!other.ok()) return UsageError(env, other.status().message());
    for (const RuleSet* set : {&*rules, &*other}) {
      if (set->program == nullptr && !set->files.empty()) return Refused(env, *set);
    }

    if (const absl::Status known = CheckPrograms({&*rules, &*other}); !known.ok()) {
      return UsageError(env, known.message());
    }

    std::vector<recording::RecordedAlert> recorded;
    const absl::StatusOr<Result> result = Replay(env, *rules, &recorded);
    if (!result.ok()) return UsageError(env, result.status().message());
    std::optional<replay::Difference> difference;
    absl::StatusOr<Result> after = Result{};
    if (other->program != nullptr) {
      after = Replay(env, *other, nullptr);
      if (!after.ok()) return UsageError(env, after.status().message());
      if (!OfTheSame(*result, *after)) {
        return UsageError(env, absl::StrCat("`", events_, "` changed while it was read; replay a ",
                                            "copy of it"));
      }
      difference = replay::Compare(*result, *after);
    }
    if (env.json()) {
      Json json = replay::ToJson(*result);
      if (!recorded.empty()) json["recorded"] = RecordedJson(recorded, *result);
      if (difference.has_value()) {
        json["against"] = replay::ToJson(*difference);
        json["against"]["rules"] = replay::ToJson(*after)["rules"];
      }
      PrintJson(json, env.out);
    } else {
      PrintResult(*result, *rules, profile_, env.out);
      PrintRecorded(recorded, *result, env.out);
      if (difference.has_value()) {
        PrintDifference(*difference, result->timed, env.out);
        PrintNotTold(*after, *other, env.out);
      }
    }
    return result->missing.empty() ? ExitCode::kDone : ExitCode::kIncomplete;
  }

 private:
  // Both are of the same events: one that is still being written grows.
  static bool OfTheSame(const Result& one, const Result& other) {
    return one.events.message == other.events.message && one.events.graph == other.events.graph &&
           one.events.external == other.events.external && one.missing == other.missing;
  }

  absl::StatusOr<RuleSet> Load(const std::vector<std::string>& paths) const {
    using Dialect = lang::CheckedRules::Dialect;
    using engine::OnInspectionError;
    return replay::LoadRuleSet(
        paths,
        {.dialect = dialect_ == "rips" ? Dialect::kRips : Dialect::kPrototype,
         .on_inspection_error = on_inspection_error_ == "match"   ? OnInspectionError::kMatch
                                : on_inspection_error_ == "alert" ? OnInspectionError::kAlert
                                                                  : OnInspectionError::kIgnore},
        &clock_);
  }

  // As `rules check`.
  static ExitCode Refused(Env& env, const RuleSet& set) {
    if (env.json()) {
      PrintJson(Json::parse(lang::RenderJson(set.files, set.diagnostics)), env.out);
    } else {
      env.out << Lines{lang::RenderText(set.files, set.diagnostics)};
    }
    return ExitCode::kRefused;
  }

  absl::StatusOr<levels::LevelIndex> FindLevel(const levels::LevelTable& levels,
                                               const std::string& flag,
                                               const std::string& name) const {
    const std::optional<levels::LevelIndex> found = levels.Find(name);
    if (found.has_value()) return *found;
    return absl::InvalidArgumentError(absl::StrCat(flag, ": the rules have no level `", name,
                                                   "`; they have ",
                                                   absl::StrJoin(levels.names(), ", ")));
  }

  // Some set runs each of --exec-fail.
  absl::Status CheckPrograms(const std::vector<const RuleSet*>& sets) const {
    std::set<std::string> programs;
    for (const RuleSet* set : sets) {
      if (set->program == nullptr) continue;
      const std::vector<std::string>& named = set->program->rules().programs;
      programs.insert(named.begin(), named.end());
    }
    for (const std::string& name : exec_fail_) {
      if (programs.contains(name)) continue;
      return absl::InvalidArgumentError(
          absl::StrCat("--exec-fail: the rules run no program `", name, "`; they run ",
                       programs.empty() ? "none" : absl::StrJoin(programs, ", ")));
    }
    return absl::OkStatus();
  }

  absl::StatusOr<levels::LevelIndex> StartLevel(const RuleSet& rules,
                                                const recording::Reader& reader, Env& env) const {
    const levels::LevelTable& levels = rules.program->rules().levels;
    if (!start_level_.empty()) return FindLevel(levels, "--start-level", start_level_);
    if (reader.origin() == nullptr || reader.origin()->level.empty()) {
      return rules.start_level;
    }
    const std::string& recorded = reader.origin()->level;
    const std::optional<levels::LevelIndex> found = levels.Find(recorded);
    if (!found.has_value()) {
      env.err << "note: the recording starts at level `" << EscapeText(recorded)
              << "`, which the rules do not have; starting at `"
              << EscapeText(levels.name(rules.start_level)) << "`\n";
    }
    return found.value_or(rules.start_level);
  }

  static void NoteOtherRules(const recording::RecordedOrigin& origin, const RuleSet& rules,
                             Env& env) {
    std::set<std::string> unknown;
    for (const auto& [name, value] : origin.variables) unknown.insert(name);
    for (const lang::Variable& each : rules.program->rules().variables) unknown.erase(each.name);
    const bool other_bundle = !rules.bundle_id.empty() && !origin.bundle_id.empty() &&
                              rules.bundle_id != origin.bundle_id;
    if (!other_bundle && unknown.empty()) return;
    env.err << "note: these are not the rules that it was recorded under (bundle "
            << EscapeText(origin.bundle_id) << ")";
    if (!unknown.empty()) {
      env.err << "; they lack " << EscapeText(absl::StrJoin(unknown, ", "));
    }
    env.err << "\n";
  }

  // `recorded`: the alerts that the recording was saved with; null for rules of which it is known
  // that they are others.
  absl::StatusOr<Result> Replay(Env& env, const RuleSet& rules,
                                std::vector<recording::RecordedAlert>* recorded) const {
    const levels::LevelTable& levels = rules.program->rules().levels;
    replay::ReplayOptions options{.tick_ns = tick_ms_ * kNanosPerMilli,
                                  .event_interval_ns = interval_ms_ * kNanosPerMilli,
                                  .profile_clock = profile_ ? &clock_ : nullptr};
    options.failing_programs.insert(exec_fail_.begin(), exec_fail_.end());
    for (const std::string& name : trigger_fail_) {
      RIPS_ASSIGN_OR_RETURN(const levels::LevelIndex level,
                            FindLevel(levels, "--trigger-fail", name));
      options.failing_levels.insert(level);
    }
    RIPS_ASSIGN_OR_RETURN(const std::unique_ptr<recording::Reader> reader,
                          recording::Open(events_));
    RIPS_ASSIGN_OR_RETURN(options.start_level, StartLevel(rules, *reader, env));
    const recording::RecordedOrigin* origin = reader->origin();
    if (origin != nullptr && recorded != nullptr) {
      *recorded = origin->alerts;
      NoteOtherRules(*origin, rules, env);
    }
    const std::unique_ptr<inspect::Session> session = rules.NewSession();
    absl::StatusOr<Result> result =
        replay::Replay(*reader, rules.program, std::move(options), session.get());
    if (result.ok() || absl::StrContains(result.status().message(), events_)) return result;
    return absl::Status(result.status().code(),
                        absl::StrCat(events_, ": ", result.status().message()));
  }

  const RealClock clock_;
  std::vector<std::string> rules_;
  std::string events_;
  std::vector<std::string> against_;
  std::string dialect_ = "rips";
  std::string start_level_;
  int64_t tick_ms_ = 0;
  int64_t interval_ms_ = 1;
  std::vector<std::string> exec_fail_;
  std::vector<std::string> trigger_fail_;
  std::string on_inspection_error_ = "match";
  bool profile_ = false;
};

}  // namespace

Commands ReplayRules() { return MakeCommands<ReplayRulesCommand>(); }

}  // namespace rips::ripsctl
