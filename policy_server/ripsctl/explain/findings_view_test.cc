#include "policy_server/ripsctl/explain/findings_view.h"

#include <sstream>
#include <string>
#include <utility>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "policy_server/ripsctl/samples.h"

namespace rips::ripsctl {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

std::string Now(const absl::StatusOr<v1::GetCoverageResponse>& findings) {
  std::ostringstream out;
  PrintFindingsNow("r1", findings, out);
  return out.str();
}

Explanation With(const std::string& state, int64_t ended_unix_ns = 0,
                 const std::string& not_known = "") {
  Explanation explanation{.recorded = MakeFindingExplained()};
  v1::GetCoverageResponse findings = MakeFindings(0);
  v1::FindingState& told = *findings.mutable_finding_state();
  told.set_state(state);
  if (state == "stands") told.set_since_unix_ns(kNewYear);
  told.set_ended_unix_ns(ended_unix_ns);
  if (!not_known.empty()) told.add_not_known(not_known);
  explanation.findings = std::move(findings);
  return explanation;
}

std::string State(const Explanation& explanation) {
  std::ostringstream out;
  PrintFinding(explanation, out);
  const std::string text = out.str();
  const std::string head =
      "\nFinding: non_ros_reader, topic /camera, GUID 01104a3b.00000000.00000000.000001c1\n  ";
  EXPECT_EQ(text.substr(0, head.size()), head);
  return text.substr(head.size());
}

TEST(FindingsViewTest, ShowsWhatStandsInBrief) {
  EXPECT_EQ(Now(MakeFindings(0)), "\nFindings: none stands\n");
  v1::GetCoverageResponse findings = MakeFindings(3);
  findings.mutable_findings_now()->mutable_kinds(0)->set_count(2);
  v1::FindingCount& other = *findings.mutable_findings_now()->add_kinds();
  other.set_kind("duplicate_node");
  other.set_count(1);
  v1::StandingFinding& second = *findings.mutable_findings_now()->add_newest();
  second.mutable_finding()->set_kind("duplicate_node");
  second.mutable_finding()->set_node("/arm");
  second.set_since_unix_ns(kNewYear);
  v1::StandingFinding& both = *findings.mutable_findings_now()->add_newest();
  both = findings.findings_now().newest(0);
  *both.add_subjects() = MakeReader();
  both.mutable_subjects(1)->set_pid(0);
  EXPECT_EQ(Now(findings),
            R"(
Findings: 3 stand now: 2 non_ros_reader, 1 duplicate_node
  NEWEST          SINCE                     NODE  TOPIC    ADDRESS    HOST    PID   GUID
  non_ros_reader  2026-01-01T00:00:00.000Z  -     /camera  10.0.0.66  lab-pc  4711  01104a3b.00000000.00000000.000001c1
  duplicate_node  2026-01-01T00:00:00.000Z  /arm  -        -          -       -     -
  non_ros_reader  2026-01-01T00:00:00.000Z  -     /camera  10.0.0.66  lab-pc  4711  01104a3b.00000000.00000000.000001c1
  -               -                         -     -        10.0.0.66  lab-pc  -     01104a3b.00000000.00000000.000001c1
  all of them, with details: ripsctl robot coverage r1
)");
}

TEST(FindingsViewTest, WhatIsNotKnownDoesNotReadAsNone) {
  v1::GetCoverageResponse findings = MakeFindings(0);
  findings.mutable_findings_now()->add_not_known("sensor base is not connected");
  EXPECT_EQ(Now(findings),
            "\nFindings: not known whether any stands\n"
            "  not all is known: sensor base is not connected\n");
  findings = MakeFindings(2);
  findings.mutable_findings_now()->add_not_known("sensor base is not connected");
  EXPECT_THAT(Now(findings), AllOf(HasSubstr("\nFindings: 2 stood as reported last: 2 non_ros_"),
                                   HasSubstr("  not all is known: sensor base is not conn")));
  for (const std::string& text :
       {Now(absl::UnavailableError("no \x1b answer")), Now(v1::GetCoverageResponse())}) {
    EXPECT_THAT(text, AllOf(HasSubstr("\nFindings: not known: "), Not(HasSubstr("\x1b")),
                            HasSubstr("\n  try: ripsctl robot coverage r1\n")));
  }
}

TEST(FindingsViewTest, SaysWhetherAFindingStillStands) {
  EXPECT_EQ(State(With("stands")), "still stands, known since 2026-01-01T00:00:00.000Z\n");
  EXPECT_EQ(State(With("ended", kNewYear)), "ended at 2026-01-01T00:00:00.000Z\n");
  EXPECT_EQ(
      State(With("ended", kNewYear, "sensor base is not connected")),
      "ended at 2026-01-01T00:00:00.000Z; whether it began again is not known: sensor base is "
      "not connected\n");
  EXPECT_EQ(State(With("ended")), "does not stand any more; when it ended is not recorded\n");
  EXPECT_EQ(State(With("not known", 0, "sensor base is not connected")),
            "not known whether it still stands: sensor base is not connected\n");
  Explanation stood = With("not known", 0, "sensor base is silent");
  (*stood.findings)->mutable_finding_state()->set_since_unix_ns(kNewYear);
  EXPECT_EQ(State(stood),
            "not known whether it still stands: sensor base is silent; it stood as reported last, "
            "since 2026-01-01T00:00:00.000Z\n");
  for (const char* state : {"", "gone", "\x1b"}) {
    EXPECT_EQ(State(With(state)), "not known whether it still stands\n");
  }
  std::ostringstream out;
  PrintFinding({.recorded = {}}, out);
  EXPECT_EQ(out.str(), "");
}

TEST(FindingsViewTest, TheRecordedEndHoldsUnlessItStandsAgain) {
  const auto recorded = [](Explanation explanation) {
    explanation.recorded.set_finding_ended_unix_ns(kNewYear + 1'000'000'000);
    return State(explanation);
  };
  EXPECT_EQ(recorded(With("ended", kNewYear + 5'000'000'000)),
            "ended at 2026-01-01T00:00:01.000Z\n")
      << "the first end";
  EXPECT_EQ(recorded(With("ended")), "ended at 2026-01-01T00:00:01.000Z\n");
  EXPECT_EQ(
      recorded(With("not known", 0, "sensor base is silent")),
      "ended at 2026-01-01T00:00:01.000Z; whether it began again is not known: sensor base is "
      "silent\n");
  EXPECT_THAT(recorded(With("stands")), HasSubstr("still stands, "));
  EXPECT_THAT(recorded({.recorded = MakeFindingExplained()}), HasSubstr("ended at "));
  EXPECT_EQ(State({.recorded = MakeFindingExplained()}),
            "not known whether it still stands: the robot's state is not known\n");
}

TEST(FindingsViewTest, HostileTextCannotLeaveItsPlace) {
  const std::string evil = "\x1b[2J\r\nFindings: none stands \xe2\x80\xae";
  v1::GetCoverageResponse findings = MakeFindings(40);
  v1::FindingsNow& now = *findings.mutable_findings_now();
  for (int i = 0; i < 40; ++i) {
    now.add_not_known(evil);
    now.add_kinds()->set_kind(evil);
    v1::StandingFinding& standing = *now.add_newest();
    standing.mutable_finding()->set_kind(evil);
    standing.mutable_finding()->set_node(absl::StrCat(evil, std::string(500, 'x')));
    standing.mutable_finding()->set_topic(std::string(500, 'y'));
    standing.mutable_finding()->set_guid(evil);
    standing.add_subjects()->set_host(absl::StrCat(evil, std::string(500, 'z')));
  }
  Explanation explanation = With("not known", 0, evil);
  *explanation.recorded.mutable_finding() = now.newest(3).finding();
  std::ostringstream out;
  PrintFinding(explanation, out);
  for (const std::string& text : {Now(findings), out.str()}) {
    EXPECT_EQ(text.find_first_of("\x1b\r"), std::string::npos);
    EXPECT_THAT(text, AllOf(Not(HasSubstr("\xe2\x80\xae")), Not(HasSubstr("\nFindings: none"))));
  }
  EXPECT_THAT(Now(findings), Not(HasSubstr(std::string(65, 'y'))));
  EXPECT_LT(Now(findings).size(), 16'000u) << "few rows, few reasons";
}

}  // namespace
}  // namespace rips::ripsctl
