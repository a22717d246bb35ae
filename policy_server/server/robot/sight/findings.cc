#include "policy_server/server/robot/sight/findings.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <utility>

#include "absl/container/btree_map.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/trace/tracer.h"
#include "policy_server/server/robot/sight/finding_kinds.h"

namespace rips::pipeline {
namespace {

// Behind `finding `.
std::string Text(const FindingSeen& finding) {
  std::string text = finding.kind;
  if (!finding.node.empty()) absl::StrAppend(&text, ", node ", finding.node);
  if (!finding.topic.empty()) absl::StrAppend(&text, ", topic ", finding.topic);
  if (!finding.guid.none()) absl::StrAppend(&text, ", GUID ", ToString(finding.guid));
  if (!finding.detail.empty()) absl::StrAppend(&text, ": ", finding.detail);
  return text;
}

// A sensor also reports how many others came and went; that names nothing.
bool HasSubject(const FindingSeen& finding) {
  return !finding.guid.none() || !finding.node.empty() || !finding.topic.empty();
}

std::string EventOf(absl::string_view kind) {
  return kind.empty() ? "finding" : absl::StrCat("finding ", kind);
}

void Log(absl::string_view what, const FindingSeen& finding, Context& context) {
  context.Do(
      action::LogRule{std::string(kOwnRule), absl::StrCat(what, ": finding ", Text(finding))});
}

engine::SharedTrace TraceOf(const FindingSeen& finding, const ros2::RosGraph& graph) {
  if (!HasSubject(finding)) return nullptr;
  return std::make_shared<const engine::Trace>(engine::TraceFinding(finding, graph));
}

}  // namespace

// --------------------------------------------------------------------------- what sensors report

bool Findings::OnFinding(const std::string& host, const std::string& incarnation,
                         const FindingSeen& finding) {
  switch (registry_.Apply(host, incarnation, finding, context_.now_ns())) {
    case FindingRegistry::News::kKnown:
      return false;
    case FindingRegistry::News::kEnds:
      SetOther(finding.kind);
      Recount();
      Log("no longer", finding, context_);
      RaiseEnd("finding ended", finding, registry_.ended().back().named);
      return false;
    case FindingRegistry::News::kBegins:
    case FindingRegistry::News::kTooMany:
      SetOther(finding.kind);
      Recount();
      gate_.Contradict(absl::StrCat("sensor ", host, " found ",
                                    IsKindOfRules(finding.kind) ? finding.kind : "something"));
      break;
  }
  // A sensor may make kinds up, and each kind has its own limit.
  const bool listed = IsKindOfRules(finding.kind);
  const std::string limit = EventOf(listed ? finding.kind : "");
  const bool raised = alerts_.RaiseOfKind(
      limit, engine::Severity::kHigh, absl::StrCat("sensor ", host, ": finding ", Text(finding)),
      EventOf(finding.kind), TraceOf(finding, state_.graph.get()));
  if (!raised) folded_.insert({.limit = limit, .kind = listed ? finding.kind : ""});
  FindingRegistry::Entry* entry = registry_.Find(FindingRegistry::KeyOf(finding));
  if (entry != nullptr) entry->named = raised;
  return listed;
}

void Findings::RaiseEnd(absl::string_view what, FindingSeen finding, bool named) {
  if (!named || !HasSubject(finding)) return;
  const std::string text = absl::StrCat(what, ": ", Text(finding));
  finding.over = true;
  finding.detail.clear();
  engine::Trace trace;
  trace.finding = finding;
  const std::string kind = IsKindOfRules(finding.kind) ? finding.kind : "";
  const std::string limit = absl::StrCat(EventOf(kind), " ended");
  const bool raised = alerts_.RaiseOfKind(limit, engine::Severity::kInfo, text,
                                          absl::StrCat(EventOf(finding.kind), " ended"),
                                          std::make_shared<const engine::Trace>(std::move(trace)));
  if (!raised) folded_.insert({.limit = limit, .kind = kind, .ends = true});
}

void Findings::OnHello(const SensorHost& host) {
  registry_.OnHello(host.name, host.session->incarnation, context_.now_ns());
  Update();
}

void Findings::OnState(const SensorHost& host, const SensorStateSeen& state) {
  registry_.OnState(host.name, state.findings_digest, state.findings_all_told);
  Update();
}

void Findings::OnHosts() {
  registry_.KeepOnly([this](const std::string& host) { return sensors_.hosts().contains(host); },
                     context_.now_ns());
  Expire();
}

void Findings::Expire() {
  std::vector<FindingRegistry::Entry> expired = registry_.Expire(context_.now_ns());
  for (const FindingRegistry::Entry& entry : expired) SetOther(entry.finding.kind);
  if (!expired.empty()) Recount();
  for (FindingRegistry::Entry& entry : expired) {
    Log("not told again by a sensor that was restarted or asked", entry.finding, context_);
    RaiseEnd("finding ended, as its sensor, restarted or asked to, did not report it again",
             std::move(entry.finding), entry.named);
  }
}

// ---------------------------------------------------------------------------- what rules are told

void Findings::SetOther(const std::string& kind) {
  if (IsKindOfRules(kind)) return;
  if (registry_.HasKind(kind)) {
    others_.insert(kind);
  } else {
    others_.erase(kind);
  }
}

void Findings::Recount() {
  kinds_ = {};
  for (const absl::string_view each : KindsOfRules()) {
    if (registry_.HasKind(each)) kinds_.Add(each);
  }
  if (!others_.empty()) kinds_.Add(engine::StandingFindings::kOther);
  Update();
}

std::vector<std::string> Findings::ToAsk() {
  std::vector<std::string> hosts;
  for (const auto& [name, host] : sensors_.hosts()) {
    if (!host.session || !known_.NotCurrent(host).empty()) continue;
    const FindingRegistry::Asked asked = registry_.Ask(name, context_.now_ns());
    if (asked == FindingRegistry::Asked::kNo) continue;
    hosts.push_back(name);
    if (asked == FindingRegistry::Asked::kYes) continue;
    alerts_.Raise(engine::Severity::kMedium,
                  absl::StrCat("sensor ", name,
                               " says that it finds something else than it has reported, also "
                               "after it was asked to report all again: what stands is not known. "
                               "Restart it; if this comes again, find out what uses its key"));
  }
  return hosts;
}

void Findings::Update() {
  state_.findings = kinds_;
  state_.findings.set_told_all(known_.All());
}

// ------------------------------------------------------------------------------------- summaries

void Findings::Summarize() {
  for (auto it = folded_.begin(); it != folded_.end();) {
    std::optional<FoldedAlerts> folded = alerts_.PopFolded(it->limit);
    if (!folded.has_value()) {
      ++it;
      continue;
    }
    const Folded kind = *it;
    it = folded_.erase(it);
    FindingRegistry::Entry* newest = nullptr;
    size_t standing = 0;
    for (const auto& [key, entry] : registry_.entries()) {
      const std::string& of = entry.finding.kind;
      if (kind.ends || entry.named || entry.since_ns < folded->first_ns) continue;
      if (kind.kind.empty() ? IsKindOfRules(of) : of != kind.kind) continue;
      ++standing;
      if (newest == nullptr || entry.order > newest->order) newest = registry_.Find(key);
    }
    const std::string text = SummaryOf(kind, *folded, newest, standing);
    engine::SharedTrace trace;
    if (newest != nullptr) {
      newest->named = true;
      trace = TraceOf(newest->finding, state_.graph.get());
    }
    alerts_.RaiseFolded(*std::move(folded), text, EventOf(kind.kind) + (kind.ends ? " ended" : ""),
                        std::move(trace));
  }
}

std::string Findings::SummaryOf(const Folded& kind, const FoldedAlerts& folded,
                                FindingRegistry::Entry* newest, size_t standing) const {
  const int64_t seconds = (folded.last_ns - folded.first_ns) / kNanosPerSecond + 1;
  std::string text = absl::StrCat(folded.count, " more findings ",
                                  kind.kind.empty() ? "of kinds that rules cannot name" : kind.kind,
                                  kind.ends ? " ended within " : " began within ", seconds,
                                  " s, merged into this alert");
  if (kind.ends) return absl::StrCat(text, "; last: ", folded.alert.text);
  const std::vector<std::string> not_known = known_.NotKnown();
  if (standing > 0) {
    absl::StrAppend(&text, "; ", standing, " of them ",
                    not_known.empty() ? "stand now" : "stood as reported last");
  } else {
    absl::StrAppend(&text, not_known.empty() ? "; none of them stands now"
                                             : "; whether they stand is not known");
  }
  if (!not_known.empty()) absl::StrAppend(&text, " (", not_known.front(), ")");
  absl::StrAppend(&text, "; all that stand: ripsctl robot coverage ", context_.config.id);
  return newest != nullptr
             ? absl::StrCat(text, "; the newest of them: finding ", Text(newest->finding))
             : absl::StrCat(text, "; last: ", folded.alert.text);
}

}  // namespace rips::pipeline
