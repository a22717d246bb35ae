#include "policy_server/server/robot/sight/findings_known.h"

#include <algorithm>
#include <utility>

#include "absl/container/btree_map.h"
#include "absl/strings/str_cat.h"
#include "policy_server/policy/engine/trace/tracer.h"
#include "policy_server/server/robot/sight/finding_kinds.h"
#include "services/ros2/ros_name.h"

namespace rips::pipeline {
namespace {

// By which what is read back may be forged: another sends what one of the parts or agents is
// thought to send, or answers for it. `of_parts_alone`: it is never about others.
struct ForgeryKind {
  absl::string_view name;
  bool of_parts_alone = false;
};
constexpr ForgeryKind kForgeryKinds[] = {{"spoofed_writer"},
                                         {"sequence_jump"},
                                         {"two_contents"},
                                         {"rival_server", /*of_parts_alone=*/true}};

}  // namespace

bool FindingsKnown::All() const {
  if (sensors_.hosts().empty() || !sight_.blind().empty() || context_.moment.backlog) return false;
  return std::all_of(sensors_.hosts().begin(), sensors_.hosts().end(),
                     [this](const auto& host) { return NotToldAll(host.second).empty(); });
}

std::string FindingsKnown::NotCurrent(const SensorHost& host) const {
  if (!host.session) return absl::StrCat("sensor ", host.name, " is not connected");
  if (context_.now_ns() - host.session->heard_ns > context_.timing.stale_ns) {
    return absl::StrCat("sensor ", host.name, " is silent");
  }
  if (std::string doubt = sensors_.DoubtOf(host); !doubt.empty()) return doubt;
  if (host.HasBacklog()) {
    return absl::StrCat("observations of sensor ", host.name, " are not judged yet");
  }
  return "";
}

std::string FindingsKnown::NotToldAll(const SensorHost& host) const {
  std::string reason = NotCurrent(host);
  if (!reason.empty()) return reason;
  reason = registry_.NotToldAll(host.name);
  if (!reason.empty()) return absl::StrCat("sensor ", host.name, " ", reason);
  if (host.name == context_.config.primary_sensor && !host.settled) {
    return absl::StrCat("the graph of sensor ", host.name, " has not settled");
  }
  return "";
}

std::vector<std::string> FindingsKnown::NotKnown() const {
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

std::string FindingsKnown::ForgeryOf(const std::vector<ros2::Guid>& participants) const {
  for (const ForgeryKind& kind : kForgeryKinds) {
    const FindingRegistry::Key first{std::string(kind.name), ros2::Guid(), "", ""};
    for (auto it = registry_.entries().lower_bound(first);
         it != registry_.entries().end() && it->second.finding.kind == kind.name; ++it) {
      const FindingSeen& finding = it->second.finding;
      const ros2::Guid participant = finding.guid.Participant();
      if (!kind.of_parts_alone &&
          std::find(participants.begin(), participants.end(), participant) == participants.end()) {
        continue;
      }
      return ros2::Printable(absl::StrCat("finding ", finding.kind, " of ", ToString(finding.guid),
                                          " ", finding.node, " ", finding.topic,
                                          ": what is read back from the robot may be forged"));
    }
  }
  return "";
}

FindingsNow FindingsKnown::Now() const {
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
                          .subjects = engine::TraceFinding(newest[i]->finding, rules_.graph.get(),
                                                           kFindingSubjectsMax)
                                          .subjects});
  }
  return now;
}

FindingState FindingsKnown::StateOf(const FindingSeen& finding) const {
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

int64_t FindingsKnown::UnixOf(int64_t boottime_ns) const {
  return context_.now().unix_ns - (context_.now_ns() - boottime_ns);
}

}  // namespace rips::pipeline
