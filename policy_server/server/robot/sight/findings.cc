#include "policy_server/server/robot/sight/findings.h"

#include <algorithm>
#include <memory>
#include <optional>
#include <span>
#include <utility>

#include "absl/container/btree_map.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/trace/tracer.h"
#include "policy_server/policy/lang/check/signature.h"

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

// Those that rules can ask for.
std::span<const absl::string_view> KindsOfRules() {
  return lang::SignatureOf(lang::Builtin::kFinding).parameters[0].words;
}

bool IsKindOfRules(absl::string_view kind) {
  const auto kinds = KindsOfRules();
  return std::find(kinds.begin(), kinds.end(), kind) != kinds.end();
}

// A sensor also reports how many others came and went; that names nothing.
bool HasSubject(const FindingSeen& finding) {
  return !finding.guid.none() || !finding.node.empty() || !finding.topic.empty();
}

std::string EventOf(absl::string_view kind) {
  return kind.empty() ? "finding" : absl::StrCat("finding ", kind);
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
      Log("no longer", finding);
      RaiseEnd("finding ended", finding, registry_.ended().back().named);
      return false;
    case FindingRegistry::News::kBegins:
    case FindingRegistry::News::kTooMany:
      SetOther(finding.kind);
      Recount();
      gate_.Contradict("a sensor found something else", context_.now());
      break;
  }
  // A sensor may make kinds up, and each kind has its own limit.
  const bool listed = IsKindOfRules(finding.kind);
  const std::string limit = EventOf(listed ? finding.kind : "");
  const bool raised = alerts_.RaiseOfKind(
      limit, engine::Severity::kHigh, absl::StrCat("sensor ", host, ": finding ", Text(finding)),
      EventOf(finding.kind), TraceOf(finding));
  if (!raised) folded_.insert({.limit = limit, .kind = listed ? finding.kind : ""});
  FindingRegistry::Entry* entry = registry_.Find(FindingRegistry::KeyOf(finding));
  if (entry != nullptr) entry->named = raised;
  return listed;
}

void Findings::Log(absl::string_view what, const FindingSeen& finding) {
  context_.Do(
      action::LogRule{std::string(kOwnRule), absl::StrCat(what, ": finding ", Text(finding))});
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
    Log("not told again by a sensor that was restarted or asked", entry.finding);
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
    if (!host.session || !NotCurrent(host).empty()) continue;
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
  bool told_all = !sensors_.hosts().empty() && sight_.blind().empty() && !context_.moment.backlog;
  for (const auto& [name, host] : sensors_.hosts()) {
    told_all = told_all && NotToldAll(host).empty();
  }
  state_.findings = kinds_;
  state_.findings.set_told_all(told_all);
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
      trace = TraceOf(newest->finding);
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
  const std::vector<std::string> not_known = NotKnown();
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

// ---------------------------------------------------------------------------------- what is known

std::string Findings::NotCurrent(const SensorHost& host) const {
  if (!host.session) return absl::StrCat("sensor ", host.name, " is not connected");
  if (context_.now_ns() - host.session->heard_ns > context_.timing.stale_ns) {
    return absl::StrCat("sensor ", host.name, " is silent");
  }
  if (host.HasBacklog()) {
    return absl::StrCat("observations of sensor ", host.name, " are not judged yet");
  }
  return "";
}

std::string Findings::NotToldAll(const SensorHost& host) const {
  std::string reason = NotCurrent(host);
  if (!reason.empty()) return reason;
  reason = registry_.NotToldAll(host.name);
  if (!reason.empty()) return absl::StrCat("sensor ", host.name, " ", reason);
  if (host.name == context_.config.primary_sensor && !host.settled) {
    return absl::StrCat("the graph of sensor ", host.name, " has not settled");
  }
  return "";
}

std::vector<std::string> Findings::NotKnown() const {
  std::vector<std::string> reasons;
  for (const auto& [name, host] : sensors_.hosts()) {
    if (reasons.size() == kNotKnownMax) break;
    std::string reason = NotToldAll(host);
    if (!reason.empty()) reasons.push_back(std::move(reason));
  }
  for (const std::string& reason : sight_.blind()) {
    if (reasons.size() < kNotKnownMax) reasons.push_back(reason);
  }
  if (context_.moment.backlog) reasons.push_back("what its agents sent is not judged yet");
  if (sensors_.hosts().empty()) reasons.push_back("the inventory lists no sensor of this robot");
  return reasons;
}

FindingsNow Findings::Now() const {
  FindingsNow now{.total = registry_.entries().size(), .not_known = NotKnown()};
  absl::btree_map<std::string, size_t> counts;
  std::vector<const FindingRegistry::Entry*> newest;
  newest.reserve(now.total);
  for (const auto& [key, entry] : registry_.entries()) {
    ++counts[IsKindOfRules(entry.finding.kind) ? entry.finding.kind : kOtherKinds];
    newest.push_back(&entry);
  }
  now.kinds.assign(counts.begin(), counts.end());
  std::stable_sort(now.kinds.begin(), now.kinds.end(),
                   [](const auto& a, const auto& b) { return a.second > b.second; });
  const size_t shown = std::min(newest.size(), kNewestFindingsMax);
  std::partial_sort(newest.begin(), newest.begin() + static_cast<ptrdiff_t>(shown), newest.end(),
                    [](const auto* a, const auto* b) { return a->order > b->order; });
  for (size_t i = 0; i < shown; ++i) {
    now.newest.push_back({.finding = newest[i]->finding,
                          .since_unix_ns = UnixOf(newest[i]->since_ns),
                          .subjects = engine::TraceFinding(newest[i]->finding, state_.graph.get(),
                                                           kFindingSubjectsMax)
                                          .subjects});
  }
  return now;
}

FindingState Findings::StateOf(const FindingSeen& finding) const {
  using State = FindingState::State;
  const FindingRegistry::Key key = FindingRegistry::KeyOf(finding);
  if (const FindingRegistry::Entry* entry = registry_.Find(key)) {
    FindingState state{.since_unix_ns = UnixOf(entry->since_ns)};
    for (const auto& [name, until_ns] : entry->told_by) {
      const auto host = sensors_.hosts().find(name);
      std::string reason;
      if (host == sensors_.hosts().end()) {
        reason = absl::StrCat("the inventory no longer lists sensor ", name);
      } else if (reason = NotCurrent(host->second); reason.empty() && until_ns != 0) {
        reason = absl::StrCat("sensor ", name, " was restarted and has not reported it again yet");
      }
      if (reason.empty()) return {.state = State::kStands, .since_unix_ns = state.since_unix_ns};
      if (state.not_known.size() < kNotKnownMax) state.not_known.push_back(std::move(reason));
    }
    return state;
  }
  // It may have begun anew where not all is known.
  FindingState state{.not_known = NotKnown()};
  const auto& ended = registry_.ended();
  const auto end = std::find_if(ended.rbegin(), ended.rend(),
                                [&key](const auto& each) { return each.key == key; });
  if (end != ended.rend()) state.ended_unix_ns = UnixOf(end->at_ns);
  if (end != ended.rend() || state.not_known.empty()) state.state = State::kEnded;
  return state;
}

engine::SharedTrace Findings::TraceOf(const FindingSeen& finding) const {
  if (!HasSubject(finding)) return nullptr;
  return std::make_shared<const engine::Trace>(engine::TraceFinding(finding, state_.graph.get()));
}

int64_t Findings::UnixOf(int64_t boottime_ns) const {
  return context_.now().unix_ns - (context_.now_ns() - boottime_ns);
}

}  // namespace rips::pipeline
