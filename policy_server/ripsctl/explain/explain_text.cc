#include "policy_server/ripsctl/explain/explain_text.h"

#include <algorithm>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "policy_server/ripsctl/cli/firewalls.h"
#include "policy_server/ripsctl/cli/json_view.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "policy_server/ripsctl/cli/robot_level.h"
#include "policy_server/ripsctl/explain/findings_view.h"
#include "services/text/utf8.h"

namespace rips::ripsctl {
namespace {

constexpr absl::string_view kOwnRule = "(rips)";
constexpr size_t kConditionLinesMax = 20;
constexpr size_t kConditionColumns = 160;
constexpr size_t kPieceColumns = 56;
constexpr size_t kValueColumns = 100;
// Deeper values are shown at this depth: the columns go to what they say.
constexpr uint32_t kDepthShownMax = 8;

// The start of `text`, which is escaped.
std::string CutColumns(std::string text, size_t columns) {
  if (CountCodePoints(text) <= columns) return text;
  size_t end = 0;
  for (size_t i = 0; i + 3 < columns; ++i) end += DecodeCodePoint(text, end).length;
  return absl::StrCat(absl::string_view(text).substr(0, end), "...");
}

bool IsBlank(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\n'; }

// Without comments, each run of white space outside of strings as one blank.
std::string OnOneLine(absl::string_view source) {
  std::string out;
  bool in_string = false;
  for (size_t i = 0; i < source.size(); ++i) {
    const char c = source[i];
    if (!in_string && (IsBlank(c) || c == '#')) {
      if (c == '#') i = std::min(source.find('\n', i), source.size());
      if (!out.empty() && out.back() != ' ') out += ' ';
      continue;
    }
    if (c == '"') in_string = !in_string;
    out += c;
    if (in_string && c == '\\' && i + 1 < source.size()) out += source[++i];
  }
  return std::string(absl::StripTrailingAsciiWhitespace(out));
}

// What has become of a decision, in plain words; empty if nothing is known.
std::string StageText(const std::string& stage) {
  constexpr std::pair<absl::string_view, absl::string_view> kMeanings[] = {
      {"requested", "not every actuator has acknowledged it yet"},
      {"acknowledged", "the actuators carry it out; not each has read it back yet"},
      {"verified", "every actuator has read the level back"},
      {"contradicted", "every actuator has read it back, and the robot shows that it is not so"},
      {"failed", "an actuator cannot reach the level; it tries again"},
      {"superseded", "a newer decision took its place before it was verified"},
  };
  for (const auto& [name, meaning] : kMeanings) {
    if (stage == name) return absl::StrCat(stage, ": ", meaning);
  }
  return EscapeText(stage);
}

std::string Times(uint32_t count) { return count == 1 ? "once" : absl::StrCat(count, " times"); }

// Behind `, ` or another separator, escaped; nothing if it is empty.
std::string Behind(absl::string_view separator, absl::string_view text) {
  return text.empty() ? "" : absl::StrCat(separator, EscapeText(text));
}

std::string DecisionIn(absl::string_view before, const v1::DecisionId& decision_id,
                       absl::string_view after) {
  return decision_id.term() == 0 && decision_id.epoch() == 0
             ? ""
             : absl::StrCat(before, DecisionIdText(decision_id), after);
}

std::string TransitionLine(const v1::Transition& transition) {
  const std::string robot = EscapeText(transition.robot());
  const std::string from = EscapeText(transition.from());
  const std::string to = EscapeText(transition.to());
  const std::string time = ShortTime(transition.time_unix_ns());
  if (transition.refused()) {
    return absl::StrCat(robot, " stayed at ", from, ": the change to ", to, " was refused ",
                        Times(transition.count()), ", at ", time, Behind(": ", transition.reason()),
                        Behind("; asked by ", transition.cause()));
  }
  return absl::StrCat(robot, " went from ", from, " to ", to, " at ", time,
                      DecisionIn(" (decision ", transition.decision_id(), ")"),
                      Behind(", by ", transition.cause()));
}

std::string AlertLine(const v1::Alert& alert) {
  const std::string rule =
      alert.rule() == kOwnRule ? "RIPS itself" : absl::StrCat("rule ", EscapeText(alert.rule()));
  // What RIPS says of an absent agent has the words already.
  const bool said = absl::StrContains(alert.text(), alert.maintenance());
  return absl::StrCat(EscapeText(alert.robot()), ": ", EscapeText(alert.severity()), " alert at ",
                      ShortTime(alert.time_unix_ns()), Behind(" in ", alert.level()),
                      DecisionIn(" (", alert.decision_id(), ")"), ", by ", rule, ": ",
                      EscapeText(alert.text()), said ? "" : Behind("; ", alert.maintenance()));
}

// Of the transition or the alert; empty if no rule did it.
std::string RuleOf(const v1::ExplainResponse& recorded) {
  absl::string_view cause = recorded.transition().cause();
  if (recorded.has_transition()) {
    if (absl::ConsumePrefix(&cause, "rule ") || absl::ConsumePrefix(&cause, "crash in rule ")) {
      return std::string(cause);
    }
    return "";
  }
  return recorded.alert().rule() == kOwnRule ? "" : recorded.alert().rule();
}

// Who made that rule fire, if anybody is known.
std::string RaisersText(const Explanation& explanation) {
  constexpr int kRaisersShown = 3;
  const auto& raisers = SubjectsOf(*explanation.raised);
  std::set<std::string> below;
  for (const v1::Subject& each : SubjectsOf(explanation.recorded)) below.insert(each.guid());
  below.erase("");
  std::vector<std::string> names;
  for (const v1::Subject& each : raisers) {
    if (names.size() == kRaisersShown) {
      names.push_back(absl::StrCat("and ", raisers.size() - kRaisersShown, " more"));
      break;
    }
    std::string name = EscapeText(each.name());
    if (!each.address().empty()) absl::StrAppend(&name, " at ", EscapeText(each.address()));
    if (below.contains(each.guid())) name += ", as below";
    names.push_back(std::move(name));
  }
  return absl::StrJoin(names, "; ");
}

// The lines of a file, those after the first as far to the left as they may stand.
std::vector<std::string> ConditionLines(absl::string_view condition) {
  std::vector<std::string> lines;
  for (absl::string_view line : absl::StrSplit(condition, '\n')) {
    lines.push_back(absl::StrReplaceAll(absl::StripTrailingAsciiWhitespace(line), {{"\t", "  "}}));
  }
  const auto indent_of = [](const std::string& line) {
    return std::min(line.find_first_not_of(' '), line.size());
  };
  size_t indent = kConditionColumns;
  for (size_t i = 1; i < lines.size(); ++i) {
    if (!lines[i].empty()) indent = std::min(indent, indent_of(lines[i]));
  }
  for (size_t i = 0; i < lines.size(); ++i) {
    lines[i].erase(0, std::min(indent_of(lines[i]), i == 0 ? lines[i].size() : indent));
    if (i > 0 && !lines[i].empty()) lines[i].insert(0, "  ");
  }
  while (!lines.empty() && lines.back().empty()) lines.pop_back();
  return lines;
}

void PrintCondition(absl::string_view condition, absl::string_view margin, TextStream out) {
  const std::vector<std::string> lines = ConditionLines(condition);
  const size_t shown = std::min(lines.size(), kConditionLinesMax);
  for (size_t i = 0; i < shown; ++i) {
    out << margin << CutColumns(EscapeText(lines[i]), kConditionColumns) << "\n";
  }
  if (shown < lines.size()) out << margin << "(" << lines.size() - shown << " more lines)\n";
}

void PrintValues(const v1::Evidence& evidence, absl::string_view margin, TextStream out) {
  std::vector<std::string> pieces;
  size_t width = 0;
  for (const v1::EvidenceValue& value : evidence.values()) {
    const size_t indent = size_t{2} * std::min(value.depth(), kDepthShownMax);
    pieces.push_back(absl::StrCat(
        std::string(indent, ' '),
        PieceText(evidence.condition(), value.offset(), value.length(), kPieceColumns - indent)));
    width = std::max(width, CountCodePoints(pieces.back()));
  }
  for (int i = 0; i < evidence.values_size(); ++i) {
    const std::string& piece = pieces[static_cast<size_t>(i)];
    out << margin << piece << std::string(width - CountCodePoints(piece) + 2, ' ')
        << CutColumns(EscapeText(evidence.values(i).value()), kValueColumns) << "\n";
  }
}

void PrintWhy(const v1::ExplainResponse& recorded, TextStream out) {
  const v1::Evidence& evidence = recorded.evidence();
  if (!recorded.has_evidence()) {
    out << "\nWhy: " << EscapeText(NoEvidenceText(recorded)) << "\n";
    out << Behind("  the event: ", recorded.alert().event())
        << (recorded.alert().event().empty() ? "" : "\n");
    return;
  }
  const std::string rule = RuleOf(recorded);
  out << "\nWhy: " << (rule.empty() ? "a rule" : absl::StrCat("rule ", EscapeText(rule)))
      << Behind(", ", evidence.place()) << Behind(", of bundle ", ShortBundle(evidence.bundle()))
      << "\n";
  if (!evidence.event().empty() || evidence.event_unix_ns() != 0) {
    out << "  the event: " << (evidence.event().empty() ? "-" : EscapeText(evidence.event()));
    if (evidence.event_unix_ns() != 0) {
      out << ", at " << ShortTime(evidence.event_unix_ns()) << " by the robot's clock";
    }
    out << "\n";
  }
  if (!evidence.condition().empty()) {
    out << "  the condition:\n";
    PrintCondition(evidence.condition(), "    ", out);
  }
  if (!evidence.values().empty()) {
    out << "  its values at that time:\n";
    PrintValues(evidence, "    ", out);
  }
}

const char* PresenceText(Presence presence) {
  switch (presence) {
    case Presence::kThere:
      return "still there";
    case Presence::kKeptOut:
      return "not seen";
    case Presence::kGone:
      return "gone";
    case Presence::kUnknown:
      break;
  }
  return "not known";
}

// Why something that is there may be missing from the graph; empty if all is seen.
std::string UnseenBecause(const Explanation& explanation) {
  if (!explanation.graph.has_value()) return "the graph is not known";
  if (!explanation.graph->ok()) return std::string(explanation.graph->status().message());
  const v1::GetGraphResponse& graph = **explanation.graph;
  if (!graph.graph().settled()) return "the graph has not settled";
  if (graph.graph().has_truncation() || graph.left_out() > 0) {
    return "the graph is larger than what is kept of it";
  }
  if (explanation.lowering.has_value() && explanation.lowering->found.ok() &&
      !explanation.lowering->found->blind_because().empty()) {
    return absl::StrJoin(explanation.lowering->found->blind_because(), "; ");
  }
  if (!explanation.now.has_value()) return "the robot's state is not known";
  if (!explanation.now->ok()) return std::string(explanation.now->status().message());
  const v1::RobotStatus& status = (*explanation.now)->status();
  // A sensor that is away shows here.
  if (!status.degraded().empty()) return absl::StrJoin(status.degraded(), "; ");
  // Until the level is read back, an actuator may be setting a firewall that it has not told of.
  const bool told = !(*explanation.now)->firewalls().empty() || status.stage() == "verified";
  return told ? "" : "the level is not read back, and a firewall may be on its way";
}

void PrintWho(const Explanation& explanation, TextStream out) {
  const v1::ExplainResponse& recorded = explanation.recorded;
  const auto& subjects = SubjectsOf(recorded);
  if (!subjects.empty()) {
    out << "\nWho:\n";
    Table table({"NAME", "WHAT", "NOW", "ADDRESS", "HOST", "PID", "GUID"});
    for (const v1::Subject& each : subjects) {
      table.Add({each.name(), each.role(), PresenceText(PresenceOf(each, explanation)),
                 each.address(), each.host(), each.pid() == 0 ? "" : absl::StrCat(each.pid()),
                 each.guid()});
    }
    table.Print(out, "  ");
    out << "  address, host and process id are what the process says of itself; it may lie\n";
    const auto any = [&](Presence presence) {
      return std::any_of(subjects.begin(), subjects.end(), [&](const v1::Subject& each) {
        return PresenceOf(each, explanation) == presence;
      });
    };
    if (any(Presence::kKeptOut)) {
      out << "  not seen: it left the robot's graph, but a firewall would hide it there; whether "
             "it\n"
             "  still sends, the firewall says below; a lowering may let it in again\n";
    }
    if (any(Presence::kGone)) {
      out << "  gone: not in the robot's graph, and no actuator says that a firewall hides it\n";
    }
    const bool unknown = std::any_of(subjects.begin(), subjects.end(), [&](const auto& each) {
      return !each.guid().empty() && PresenceOf(each, explanation) == Presence::kUnknown;
    });
    if (unknown) out << "  not known: " << EscapeText(UnseenBecause(explanation)) << "\n";
  }
  if (recorded.evidence().cut()) out << "  there were more values or subjects than are kept\n";
}

// One line of what else came of the firing.
std::string OutcomeText(const v1::Transition& transition) {
  const std::string change =
      absl::StrCat(EscapeText(transition.from()), " -> ", EscapeText(transition.to()));
  if (transition.refused()) {
    return absl::StrCat(change, " refused ", Times(transition.count()),
                        Behind(": ", transition.reason()));
  }
  return absl::StrCat(change, DecisionIn(" (", transition.decision_id(), ")"),
                      Behind(", ", transition.stage()), Behind(": ", transition.detail()));
}

void PrintOutcome(const v1::ExplainResponse& recorded, TextStream out) {
  const v1::Transition& own = recorded.transition();
  const std::string stage = own.refused() ? "" : StageText(own.stage());
  std::vector<std::pair<int64_t, std::string>> lines;
  for (const v1::Alert& each : recorded.alerts()) {
    lines.emplace_back(each.time_unix_ns(),
                       absl::StrCat(EscapeText(ShortId(each.id())), "  alert, ",
                                    EscapeText(each.severity()), ": ", EscapeText(each.text())));
  }
  for (const v1::Transition& each : recorded.transitions()) {
    lines.emplace_back(each.time_unix_ns(),
                       absl::StrCat(EscapeText(ShortId(each.id())), "  level ", OutcomeText(each)));
  }
  if (stage.empty() && own.detail().empty() && lines.empty()) return;
  std::stable_sort(lines.begin(), lines.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  out << "\nEffects:\n";
  if (!stage.empty() || !own.detail().empty()) {
    out << "  " << stage << Behind(stage.empty() ? "" : "; ", own.detail()) << "\n";
  }
  for (const auto& [time, text] : lines) out << "  " << ShortTime(time) << "  " << text << "\n";
}

void PrintLowering(absl::string_view robot, const Lowering& lowering,
                   const v1::ExplainResponse& recorded, TextStream out) {
  if (!lowering.found.ok()) {
    out << "  " << EscapeText(NoDryRunText(lowering.found.status())) << "\n";
    return;
  }
  out << "  if it were lowered to " << EscapeText(lowering.to) << " now, it\n";
  const v1::LevelResponse& found = *lowering.found;
  if (found.would_raise_again().empty() && found.blind_because().empty()) {
    out << "    would not be raised again at once: no rule on the graph or a tick would fire\n";
  }
  // Of most interest is what raised the robot.
  const bool by_message = absl::StartsWith(recorded.evidence().event(), "message ");
  PrintDryRun(robot, found, !found.blind_because().empty(), "    ", out,
              by_message ? RuleOf(recorded) : "");
}

// Who may do what next, and how.
void PrintNext(const v1::GetLevelResponse& now, absl::string_view to, TextStream out) {
  const std::string robot = EscapeText(now.status().robot());
  for (const v1::PendingApproval& each : now.pending_approvals()) {
    out << "  waits for a second operator: " << EscapeText(PendingText(robot, each))
        << "\n    to approve it: ripsctl level approve " << ShellWord(now.status().robot()) << " "
        << ShellWord(ShortId(each.id())) << " --reason TEXT --wait"
        << (each.accept_blind() ? " --accept-blind" : "") << "\n";
  }
  if (now.pending_approvals().empty()) {
    out << "  to lower it: ripsctl level lower " << ShellWord(now.status().robot()) << " --to "
        << ShellWord(to) << " --reason TEXT --wait\n";
  }
}

// Which rule may lower it, and what of its condition is missing.
void PrintLoweringRule(const v1::LoweringRule& rule, TextStream out) {
  const v1::Evidence& evidence = rule.evidence();
  out << "    rule " << EscapeText(rule.rule()) << Behind(", ", evidence.place()) << ": "
      << HoldsText(rule) << "\n";
  if (evidence.values().empty()) {
    PrintCondition(evidence.condition(), "      ", out);
  } else {
    PrintValues(evidence, "      ", out);
  }
}

void PrintNow(const Explanation& explanation, TextStream out) {
  if (!explanation.now.has_value()) return;
  if (!explanation.now->ok()) {
    out << "\nNow: not known: " << EscapeText(explanation.now->status().message()) << "\n";
    return;
  }
  const v1::RobotStatus& status = (*explanation.now)->status();
  out << "\nNow: " << EscapeText(status.robot()) << " is at " << EscapeText(status.decided_level())
      << DecisionIn(" (decision ", status.decision_id(), ")");
  const std::string stage = StageText(status.stage());
  out << (stage.empty() ? "" : ", ") << stage << "\n";
  if (status.effective_level().empty()) {
    out << "  no actuator is attached\n";
  } else if (status.effective_level() != status.decided_level()) {
    out << "  its actuators hold " << EscapeText(status.effective_level()) << "\n";
  }
  std::map<std::string, std::string> claims;
  for (const v1::Subject& each : SubjectsOf(explanation.recorded)) {
    if (!each.address().empty()) claims.emplace(each.address(), each.name());
  }
  for (const v1::HostFirewall& drops : (*explanation.now)->firewalls()) {
    out << "  the firewall of " << EscapeText(drops.host()) << " " << DropsText(drops) << "\n";
    for (const std::string& line : SourceLines(drops, claims)) out << "    from " << line << "\n";
  }
  const std::string by_rules = LoweringByRulesText(**explanation.now);
  if (!by_rules.empty()) out << "  rules " << EscapeText(by_rules) << "\n";
  for (const v1::LoweringRule& rule : (*explanation.now)->lowering_rules()) {
    PrintLoweringRule(rule, out);
  }
  if (!explanation.lowering.has_value()) return;
  PrintLowering(status.robot(), *explanation.lowering, explanation.recorded, out);
  PrintNext(**explanation.now, explanation.lowering->to, out);
}

// The server keeps what led to such an alert.
void PrintRecording(const v1::Alert& alert, TextStream out) {
  if (alert.severity() != "high" && alert.severity() != "critical") return;
  out << "\nEvents that led to it:\n  ripsctl alert recording " << ShellWord(ShortId(alert.id()))
      << " --out FILE\n";
}

}  // namespace

const google::protobuf::RepeatedPtrField<v1::Subject>& SubjectsOf(
    const v1::ExplainResponse& recorded) {
  const bool by_evidence = !recorded.evidence().subjects().empty();
  return by_evidence ? recorded.evidence().subjects() : recorded.alert().subjects();
}

Presence PresenceOf(const v1::Subject& subject, const Explanation& explanation) {
  if (subject.guid().empty() || !explanation.graph.has_value() || !explanation.graph->ok()) {
    return Presence::kUnknown;
  }
  const v1::GraphSnapshot& graph = (*explanation.graph)->graph();
  const auto is_it = [&subject](const auto& each) {
    return GuidText(each.guid()) == subject.guid();
  };
  const bool there = std::any_of(graph.endpoints().begin(), graph.endpoints().end(), is_it) ||
                     std::any_of(graph.participants().begin(), graph.participants().end(), is_it);
  if (there) return Presence::kThere;
  if (!UnseenBecause(explanation).empty()) return Presence::kUnknown;
  return (*explanation.now)->firewalls().empty() ? Presence::kGone : Presence::kKeptOut;
}

std::string PieceText(absl::string_view condition, uint32_t offset, uint32_t length,
                      size_t columns) {
  if (offset >= condition.size()) return "...";
  const absl::string_view piece = condition.substr(offset, length);
  std::string text = OnOneLine(piece);
  if (piece.size() < length) text += "...";
  return CutColumns(EscapeText(text), columns);
}

std::string NoEvidenceText(const v1::ExplainResponse& recorded) {
  if (recorded.has_evidence()) return "";
  const v1::Transition& transition = recorded.transition();
  const std::string reason = transition.refused() || transition.reason().empty()
                                 ? ""
                                 : absl::StrCat("; the reason: ", transition.reason());
  if (absl::StartsWith(transition.cause(), "operator ")) {
    return absl::StrCat(
        transition.refused() ? "no rule asked for it, but " : "no rule did it, but ",
        transition.cause(), reason);
  }
  const std::string rule = RuleOf(recorded);
  if (!rule.empty()) {
    return absl::StrCat("rule ", rule, "; it was recorded before RIPS kept evidence");
  }
  if (transition.cause() == "adopted") {
    return absl::StrCat(
        "no rule did it, but RIPS itself: an actuator held another level than this server had "
        "decided, and the more restrictive one was taken",
        reason);
  }
  return absl::StrCat("no rule did it, but RIPS itself",
                      recorded.has_finding() ? ", for what a sensor found" : "", reason);
}

std::string NoDryRunText(const absl::Status& status) {
  if (absl::IsPermissionDenied(status)) {
    return "what would raise it again: to ask that needs an operator's certificate";
  }
  return absl::StrCat("what would raise it again is not known: ", status.message());
}

void PrintExplanation(const Explanation& explanation, TextStream out) {
  const v1::ExplainResponse& recorded = explanation.recorded;
  if (!recorded.has_transition() && !recorded.has_alert()) {
    const bool known = explanation.now.has_value() && explanation.now->ok();
    out << "nothing was ever decided for "
        << (known ? EscapeText((*explanation.now)->status().robot()) : "this robot")
        << ": it is where it began\n";
  } else {
    out << (recorded.has_transition() ? TransitionLine(recorded.transition())
                                      : AlertLine(recorded.alert()))
        << "\n";
    if (recorded.alert().has_acknowledged()) {
      out << "acknowledged " << AckText(recorded.alert().acknowledged()) << "\n";
    }
    if (explanation.raised.has_value()) {
      if (explanation.between.has_value()) {
        out << "before that, " << TransitionLine(*explanation.between) << "\n";
      }
      const std::string raisers = RaisersText(explanation);
      out << "before that, " << TransitionLine(explanation.raised->transition()) << "\n"
          << (raisers.empty() ? "" : "  who: ") << raisers << (raisers.empty() ? "" : "\n")
          << "  why: ripsctl explain " << ShellWord(ShortId(explanation.raised->transition().id()))
          << "\n";
    }
    PrintWhy(recorded, out);
    PrintWho(explanation, out);
    PrintFinding(explanation, out);
    PrintOutcome(recorded, out);
    PrintRecording(recorded.alert(), out);
  }
  if (explanation.findings.has_value()) {
    PrintFindingsNow((*explanation.now)->status().robot(), *explanation.findings, out);
  }
  PrintNow(explanation, out);
}

}  // namespace rips::ripsctl
