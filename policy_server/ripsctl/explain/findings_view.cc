#include "policy_server/ripsctl/explain/findings_view.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "policy_server/ripsctl/cli/json_output.h"
#include "policy_server/ripsctl/cli/printer.h"
#include "services/base/cut_text.h"

namespace rips::ripsctl {
namespace {

// In brief: a server sends no more.
constexpr int kNewestShown = 5;
constexpr int kKindsShown = 16;
constexpr int kReasonsShown = 16;
// Names in the table; `robot coverage` has all of them.
constexpr size_t kCellBytesMax = 64;
constexpr char kStands[] = "stands";
constexpr char kEnded[] = "ended";
constexpr char kNotKnown[] = "not known";

std::string FindingGuid(const v1::Finding& finding) {
  return finding.guid().empty() ? "" : GuidText(finding.guid());
}

// Of the call, or of a server that does not know the question; empty = it answered.
std::string NoAnswer(const absl::StatusOr<v1::GetCoverageResponse>& findings) {
  if (!findings.ok()) return std::string(findings.status().message());
  return findings->has_findings_now() ? "" : "the policy server is older than this ripsctl";
}

struct State {
  std::string state = kNotKnown;
  int64_t since_unix_ns = 0;
  // 0 = not recorded.
  int64_t ended_unix_ns = 0;
  std::vector<std::string> not_known;
};

// As the robot says, or else as was recorded.
State StateOf(const Explanation& explanation) {
  State out;
  if (!explanation.findings.has_value()) {
    out.not_known.emplace_back("the robot's state is not known");
  } else if (const std::string reason = NoAnswer(*explanation.findings); !reason.empty()) {
    out.not_known.push_back(reason);
  } else {
    const v1::FindingState& state = (*explanation.findings)->finding_state();
    out = {.state = state.state() == kStands || state.state() == kEnded ? state.state() : kNotKnown,
           .since_unix_ns = state.since_unix_ns(),
           .ended_unix_ns = state.ended_unix_ns(),
           .not_known = {state.not_known().begin(), state.not_known().end()}};
  }
  const int64_t recorded = explanation.recorded.finding_ended_unix_ns();
  if (out.state == kStands || recorded == 0) return out;
  // The first end after the alert.
  out.state = kEnded;
  out.ended_unix_ns = recorded;
  return out;
}

std::string StateText(const State& state) {
  const std::string why = EscapeText(absl::StrJoin(state.not_known, "; "));
  if (state.state == kStands) {
    return absl::StrCat("still stands, known since ", ShortTime(state.since_unix_ns));
  }
  if (state.state == kEnded) {
    return absl::StrCat(
        state.ended_unix_ns != 0 ? absl::StrCat("ended at ", ShortTime(state.ended_unix_ns))
                                 : "does not stand any more; when it ended is not recorded",
        why.empty() ? "" : absl::StrCat("; whether it began again is not known: ", why));
  }
  return absl::StrCat(
      "not known whether it still stands", why.empty() ? "" : absl::StrCat(": ", why),
      state.since_unix_ns == 0
          ? ""
          : absl::StrCat("; it stood as reported last, since ", ShortTime(state.since_unix_ns)));
}

// Who it is about, as far as the graph shows them: a row each.
void AddRows(const v1::StandingFinding& standing, Table& table) {
  const v1::Finding& finding = standing.finding();
  std::vector<std::string> row = {finding.kind(), ShortTime(standing.since_unix_ns()),
                                  Shortened(finding.node(), kCellBytesMax),
                                  Shortened(finding.topic(), kCellBytesMax)};
  if (standing.subjects().empty()) {
    row.insert(row.end(), {"", "", "", FindingGuid(finding)});
    return table.Add(std::move(row));
  }
  for (const v1::Subject& each : standing.subjects()) {
    row.resize(4);
    row.insert(row.end(), {each.address(), Shortened(each.host(), kCellBytesMax),
                           each.pid() == 0 ? "" : absl::StrCat(each.pid()), each.guid()});
    table.Add(row);
    row = {"", "", "", ""};
  }
}

}  // namespace

void PrintFinding(const Explanation& explanation, TextStream out) {
  if (!explanation.recorded.has_finding()) return;
  const v1::Finding& finding = explanation.recorded.finding();
  out << "\nFinding: " << EscapeText(finding.kind())
      << (finding.node().empty() ? "" : absl::StrCat(", node ", EscapeText(finding.node())))
      << (finding.topic().empty() ? "" : absl::StrCat(", topic ", EscapeText(finding.topic())))
      << (finding.guid().empty() ? "" : absl::StrCat(", GUID ", FindingGuid(finding))) << "\n  "
      << StateText(StateOf(explanation)) << "\n";
}

void PrintFindingsNow(absl::string_view robot,
                      const absl::StatusOr<v1::GetCoverageResponse>& findings, TextStream out) {
  const std::string list = absl::StrCat("ripsctl robot coverage ", ShellWord(robot));
  if (const std::string reason = NoAnswer(findings); !reason.empty()) {
    out << "\nFindings: not known: " << EscapeText(reason) << "\n  try: " << list << "\n";
    return;
  }
  const v1::FindingsNow& now = findings->findings_now();
  const bool known = now.not_known().empty();
  if (now.total() == 0) {
    out << "\nFindings: " << (known ? "none stands" : "not known whether any stands") << "\n";
  } else {
    std::vector<std::string> kinds;
    for (const v1::FindingCount& each : now.kinds()) {
      if (kinds.size() == kKindsShown) break;
      kinds.push_back(absl::StrCat(each.count(), " ", EscapeText(each.kind())));
    }
    out << "\nFindings: " << now.total() << (known ? " stand now: " : " stood as reported last: ")
        << absl::StrJoin(kinds, ", ") << "\n";
  }
  for (int i = 0; i < std::min(now.not_known_size(), kReasonsShown); ++i) {
    const std::string& reason = now.not_known(i);
    out << "  not all is known: " << EscapeText(reason) << "\n";
  }
  if (now.total() == 0) return;
  Table table({"NEWEST", "SINCE", "NODE", "TOPIC", "ADDRESS", "HOST", "PID", "GUID"});
  const int shown = std::min(now.newest_size(), kNewestShown);
  for (int i = 0; i < shown; ++i) AddRows(now.newest(i), table);
  table.Print(out, "  ");
  out << "  all of them, with details: " << list << "\n";
}

Json FindingJson(const Explanation& explanation) {
  if (!explanation.recorded.has_finding()) return nullptr;
  const v1::Finding& finding = explanation.recorded.finding();
  const State state = StateOf(explanation);
  const auto time = [](int64_t unix_ns) {
    return unix_ns == 0 ? Json(nullptr) : Json(FullTime(unix_ns));
  };
  return {{"kind", finding.kind()},
          {"guid", FindingGuid(finding)},
          {"node", finding.node()},
          {"topic", finding.topic()},
          {"state", state.state},
          {"since", time(state.since_unix_ns)},
          {"ended", time(state.ended_unix_ns)},
          {"not_known_because", JsonList(state.not_known)}};
}

Json FindingsJson(const absl::StatusOr<v1::GetCoverageResponse>& findings) {
  if (const std::string reason = NoAnswer(findings); !reason.empty()) {
    return {{"total", nullptr},
            {"kinds", Json::array()},
            {"newest", Json::array()},
            {"not_known_because", Json::array({reason})}};
  }
  const v1::FindingsNow& now = findings->findings_now();
  return {{"total", now.total()},
          {"kinds", JsonList(now.kinds(),
                             [](const v1::FindingCount& each) -> Json {
                               return {{"kind", each.kind()}, {"count", each.count()}};
                             })},
          {"newest", JsonList(now.newest(),
                              [](const v1::StandingFinding& each) -> Json {
                                return {{"kind", each.finding().kind()},
                                        {"guid", FindingGuid(each.finding())},
                                        {"node", each.finding().node()},
                                        {"topic", each.finding().topic()},
                                        {"detail", each.finding().detail()},
                                        {"since", FullTime(each.since_unix_ns())},
                                        {"subjects", JsonList(each.subjects())}};
                              })},
          {"not_known_because", JsonList(now.not_known())}};
}

}  // namespace rips::ripsctl
