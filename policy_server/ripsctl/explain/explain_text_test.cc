#include "policy_server/ripsctl/explain/explain_text.h"

#include <cstdint>
#include <limits>
#include <sstream>
#include <string>

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
using ::testing::StartsWith;

constexpr uint32_t kHuge = std::numeric_limits<uint32_t>::max();

std::string Print(const Explanation& explanation) {
  std::ostringstream out;
  PrintExplanation(explanation, out);
  return out.str();
}

v1::ExplainResponse OfTransition(const v1::Transition& transition) {
  v1::ExplainResponse response;
  *response.mutable_transition() = transition;
  return response;
}

v1::GetLevelResponse At(const std::string& level) {
  v1::GetLevelResponse response;
  *response.mutable_status() = MakeStatus("r1", level);
  for (const char* each : {"DEFAULT", "ALERT", "COMPROMISED"}) response.add_levels(each);
  return response;
}

void AddValue(v1::Evidence* evidence, uint32_t offset, uint32_t length, uint32_t depth,
              const std::string& value) {
  v1::EvidenceValue* each = evidence->add_values();
  each->set_offset(offset);
  each->set_length(length);
  each->set_depth(depth);
  each->set_value(value);
}

// Of MakeEvidence's subject.
std::string IntruderGuid() {
  return std::string("\x01\x10\x4a\x3b\0\0\0\0\0\0\0\0\0\0\x03\xc1", 16);
}

v1::GetGraphResponse GraphWithIntruder() {
  v1::GetGraphResponse graph;
  graph.mutable_graph()->set_settled(true);
  graph.mutable_graph()->add_endpoints()->set_guid(IntruderGuid());
  return graph;
}

TEST(ExplainTextTest, SaysWhoAcknowledgedAnAlert) {
  v1::ExplainResponse recorded;
  *recorded.mutable_alert() = MakeAlert("rogue driver");
  EXPECT_THAT(Print({.recorded = recorded}), Not(HasSubstr("acknowledged")));
  v1::Acknowledgement* ack = recorded.mutable_alert()->mutable_acknowledged();
  ack->set_by("spiffe://td/operator/operator/bob serial 0a");
  ack->set_time_unix_ns(kNewYear);
  EXPECT_THAT(Print({.recorded = recorded}),
              HasSubstr("rogue driver\nacknowledged at 2026-01-01T00:00:00.000Z by "
                        "spiffe://td/operator/operator/bob serial 0a\n"));
  ack->set_note("on it \x1b[2J\n");
  EXPECT_THAT(Print({.recorded = recorded}), HasSubstr("serial 0a: on it \\x1b[2J\\x0a\n"));
}

TEST(ExplainTextTest, TellsAllOfADecisionInOrder) {
  v1::ExplainResponse recorded = OfTransition(MakeTransition());
  recorded.mutable_transition()->set_detail("read back by base");
  *recorded.mutable_evidence() = MakeEvidence();
  *recorded.add_alerts() = MakeAlert("rogue driver");
  v1::Transition* refused = recorded.add_transitions();
  *refused = MakeTransition();
  refused->set_refused(true);
  refused->set_count(3);
  refused->set_reason("needs an operator");
  v1::LevelResponse found;
  found.add_would_raise_again("rogue_cmd_vel");
  const std::string text = Print({.recorded = recorded,
                                  .now = At("COMPROMISED"),
                                  .lowering = Lowering{"ALERT", found},
                                  .graph = GraphWithIntruder()});
  EXPECT_EQ(
      text,
      R"(r1 went from ALERT to COMPROMISED at 2026-01-01T00:00:00.000Z (decision 3.17), by rule rogue_cmd_vel

Why: rule rogue_cmd_vel, warehouse.rul:31, of bundle sha256:bbbbbbbbbbbb
  the event: graph change, at 2025-12-31T23:59:59.999Z by the robot's clock
  the condition:
    publisher_count("/cmd_vel") > 1
      and !nodes("/teleop")
  its values at that time:
    publisher_count("/cmd_vel") > 1 and !nodes("/teleop")  true
      publisher_count("/cmd_vel")                          2
      !nodes("/teleop")                                    not evaluated

Who:
  NAME       WHAT                NOW          ADDRESS    HOST  PID   GUID
  /intruder  publishes /cmd_vel  still there  10.0.0.66  base  4711  01104a3b.00000000.00000000.000003c1
  address, host and process id are what the process says of itself; it may lie

Effects:
  verified: every actuator has read the level back; read back by base
  2026-01-01T00:00:00.000Z  22222222  alert, high: rogue driver
  2026-01-01T00:00:00.000Z  11111111  level ALERT -> COMPROMISED refused 3 times: needs an operator

Now: r1 is at COMPROMISED (decision 3.17), verified: every actuator has read the level back
  if it were lowered to ALERT now, it
    would be raised again by rule rogue_cmd_vel at the next change of the graph, not before
    not tried: rules on messages and on external events; the next of those may raise r1 again
  to lower it: ripsctl level lower r1 --to ALERT --reason TEXT --wait
)");
}

TEST(ExplainTextTest, SaysWhetherWhoItWasIsStillThereAndNothingThatItCannotKnow) {
  v1::ExplainResponse recorded = OfTransition(MakeTransition());
  *recorded.mutable_evidence() = MakeEvidence();
  Explanation explanation{.recorded = recorded,
                          .now = At("COMPROMISED"),
                          .lowering = Lowering{"ALERT", v1::LevelResponse()},
                          .graph = GraphWithIntruder()};
  const v1::Subject& who = recorded.evidence().subjects(0);
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kThere);
  v1::GetGraphResponse& graph = **explanation.graph;
  graph.mutable_graph()->clear_endpoints();
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kGone);
  EXPECT_THAT(Print(explanation), HasSubstr("/intruder  publishes /cmd_vel  gone "));
  graph.mutable_graph()->add_participants()->set_guid(IntruderGuid());
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kThere) << "as a participant";
  graph.mutable_graph()->clear_participants();

  graph.set_left_out(1);
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kUnknown);
  graph.set_left_out(0);
  graph.mutable_graph()->mutable_truncation()->set_left_out(1);
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kUnknown);
  graph.mutable_graph()->clear_truncation();
  graph.mutable_graph()->set_settled(false);
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kUnknown);
  graph.mutable_graph()->set_settled(true);
  explanation.lowering->found->add_blind_because("sensor base lost");
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kUnknown);
  explanation.lowering->found->clear_blind_because();
  (*explanation.now)->mutable_status()->add_degraded("sensor base lost");
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kUnknown);
  EXPECT_THAT(Print(explanation), HasSubstr("\n  not known: sensor base lost\n"));
  (*explanation.now)->mutable_status()->clear_degraded();
  (*explanation.now)->mutable_status()->set_stage("acknowledged");
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kUnknown) << "a firewall may be on its way";
  EXPECT_THAT(Print(explanation), HasSubstr("\n  not known: the level is not read back, and"));
  (*explanation.now)->mutable_status()->set_stage("verified");
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kGone);
  (*explanation.now)->add_firewalls()->set_host("base");
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kKeptOut);
  EXPECT_THAT(Print(explanation),
              HasSubstr("not seen: it left the robot's graph, but a firewall would hide it there"));
  explanation.graph = absl::UnavailableError("no answer");
  EXPECT_EQ(PresenceOf(who, explanation), Presence::kUnknown);
  EXPECT_EQ(PresenceOf(v1::Subject(), explanation), Presence::kUnknown);
}

TEST(ExplainTextTest, OfALoweringNamesWhatHadRaisedTheRobot) {
  v1::Transition lowered = MakeTransition();
  lowered.set_from("COMPROMISED");
  lowered.set_to("DEFAULT");
  lowered.set_cause("operator carol");
  const std::string text =
      Print({.recorded = OfTransition(lowered), .raised = OfTransition(MakeTransition())});
  EXPECT_THAT(text,
              HasSubstr("by operator carol\nbefore that, r1 went from ALERT to COMPROMISED at "
                        "2026-01-01T00:00:00.000Z (decision 3.17), by rule rogue_cmd_vel\n"
                        "  why: ripsctl explain "));
}

TEST(ExplainTextTest, LeavesOutNoChangeBetweenTwoRaises) {
  v1::Transition lowered = MakeTransition();
  lowered.set_from("COMPROMISED");
  lowered.set_to("ALERT");
  lowered.set_cause("operator carol");
  EXPECT_THAT(Print({.recorded = OfTransition(MakeTransition()),
                     .raised = OfTransition(MakeTransition()),
                     .between = lowered}),
              HasSubstr("\nbefore that, r1 went from COMPROMISED to ALERT at "
                        "2026-01-01T00:00:00.000Z (decision 3.17), by operator carol\n"
                        "before that, r1 went from ALERT to COMPROMISED at "));
}

TEST(ExplainTextTest, NamesWhoHadRaisedTheRobotBefore) {
  v1::ExplainResponse raised = OfTransition(MakeTransition());
  *raised.mutable_evidence() = MakeEvidence();
  v1::ExplainResponse recorded = OfTransition(MakeTransition());
  EXPECT_THAT(Print({.recorded = recorded, .raised = raised}),
              HasSubstr("\n  who: /intruder at 10.0.0.66\n  why: ripsctl explain "));
  *recorded.mutable_evidence() = MakeEvidence();
  EXPECT_THAT(Print({.recorded = recorded, .raised = raised}),
              HasSubstr("\n  who: /intruder at 10.0.0.66, as below\n"));
  for (int i = 0; i < 4; ++i) {
    *raised.mutable_evidence()->add_subjects() = MakeEvidence().subjects(0);
  }
  raised.mutable_evidence()->mutable_subjects(1)->set_name("/\x1b[2J");
  raised.mutable_evidence()->mutable_subjects(1)->clear_address();
  raised.mutable_evidence()->mutable_subjects(1)->clear_guid();
  EXPECT_THAT(Print({.recorded = recorded, .raised = raised}),
              HasSubstr("at 10.0.0.66, as below; /\\x1b[2J; /intruder at 10.0.0.66, as below; "
                        "and 2 more\n"));
}

TEST(ExplainTextTest, SaysWhichLoweringWaitsAndHowToApproveIt) {
  v1::GetLevelResponse now = At("COMPROMISED");
  v1::PendingApproval& pending = *now.add_pending_approvals();
  pending.set_id(std::string(32, '3'));
  pending.set_operator_("carol (spiffe://td/operator/operator/carol serial 0c)");
  pending.set_from("COMPROMISED");
  pending.set_to("DEFAULT");
  pending.set_reason("unplugged \x1b[2J");
  pending.set_asked_unix_ns(kNewYear);
  pending.set_expires_unix_ns(kNewYear + 600'000'000'000);
  const Explanation explanation{.recorded = OfTransition(MakeTransition()),
                                .now = now,
                                .lowering = Lowering{"DEFAULT", v1::LevelResponse()}};
  const std::string text = Print(explanation);
  EXPECT_THAT(text, HasSubstr("  waits for a second operator: 33333333: operator carol asked at "
                              "2026-01-01T00:00:00.000Z to lower r1 from COMPROMISED to DEFAULT; "
                              "until 2026-01-01T00:10:00.000Z: unplugged \\x1b[2J\n"
                              "    to approve it: ripsctl level approve r1 33333333 --reason TEXT "
                              "--wait\n"));
  EXPECT_THAT(text, Not(HasSubstr("to lower it: "))) << "it was asked for";
  (*now.mutable_pending_approvals())[0].set_accept_blind(true);
  EXPECT_THAT(
      Print({.recorded = explanation.recorded, .now = now, .lowering = explanation.lowering}),
      HasSubstr("--reason TEXT --wait --accept-blind\n"));
}

TEST(ExplainTextTest, SaysThatARuleOnMessagesIsNotTried) {
  v1::ExplainResponse recorded = OfTransition(MakeTransition());
  *recorded.mutable_evidence() = MakeEvidence();
  recorded.mutable_evidence()->set_event("message on /cmd_vel from /intruder");
  EXPECT_THAT(Print({.recorded = recorded,
                     .now = At("COMPROMISED"),
                     .lowering = Lowering{"ALERT", v1::LevelResponse()}}),
              HasSubstr("not tried: rules on messages and on external events (rogue_cmd_vel is "
                        "one); the next of those may raise r1 again\n"));
}

TEST(ExplainTextTest, TellsAnAlert) {
  v1::ExplainResponse recorded;
  *recorded.mutable_alert() = MakeAlert("unknown node");
  *recorded.mutable_alert()->add_subjects() = MakeEvidence().subjects(0);
  const std::string text = Print({.recorded = recorded});
  EXPECT_THAT(text, StartsWith("r1: high alert at 2026-01-01T00:00:00.000Z in ALERT (3.16), by "
                               "rule unknown_node: unknown node\n"));
  EXPECT_THAT(text, HasSubstr("\nWhy: rule unknown_node; it was recorded before RIPS kept "
                              "evidence\n  the event: graph change\n"));
  EXPECT_THAT(text, HasSubstr("/intruder  publishes /cmd_vel")) << "the alert's own subjects";
  EXPECT_THAT(text, AllOf(Not(HasSubstr("What came")), Not(HasSubstr("Now:"))));

  recorded.mutable_alert()->set_rule("(rips)");
  EXPECT_THAT(Print({.recorded = recorded}),
              AllOf(HasSubstr(", by RIPS itself: unknown node\n"),
                    HasSubstr("Why: no rule did it, but RIPS itself\n")));

  recorded.mutable_alert()->set_maintenance("in maintenance until noon (asked by carol: \x1b[2J)");
  EXPECT_THAT(Print({.recorded = recorded}),
              AllOf(HasSubstr(": unknown node; in maintenance until noon (asked by carol: "),
                    Not(HasSubstr("\x1b"))));
}

TEST(ExplainTextTest, TellsARefusedChange) {
  v1::Transition refused = MakeTransition();
  refused.set_refused(true);
  refused.set_count(7);
  refused.set_reason("needs an operator");
  refused.clear_decision_id();
  const std::string text = Print({.recorded = OfTransition(refused)});
  EXPECT_THAT(text, StartsWith("r1 stayed at ALERT: the change to COMPROMISED was refused 7 times, "
                               "at 2026-01-01T00:00:00.000Z: needs an operator; asked by rule "
                               "rogue_cmd_vel\n"));
  EXPECT_THAT(text, Not(HasSubstr("verified"))) << "nothing was decided";
  refused.set_count(1);
  refused.set_cause("operator vera");
  EXPECT_THAT(Print({.recorded = OfTransition(refused)}),
              AllOf(HasSubstr("was refused once, at"),
                    HasSubstr("Why: no rule asked for it, but operator vera\n")));
}

TEST(ExplainTextTest, SaysWhyThereIsNoEvidence) {
  v1::Transition transition = MakeTransition();
  EXPECT_EQ(NoEvidenceText(OfTransition(transition)),
            "rule rogue_cmd_vel; it was recorded before RIPS kept evidence");
  transition.set_cause("crash in rule guard");
  EXPECT_EQ(NoEvidenceText(OfTransition(transition)),
            "rule guard; it was recorded before RIPS kept evidence");
  transition.set_cause("operator ann (spiffe://td/operator/operator/ann serial 0a)");
  transition.set_reason("smoke \x1b[2J");
  EXPECT_THAT(Print({.recorded = OfTransition(transition)}),
              HasSubstr("Why: no rule did it, but operator ann "
                        "(spiffe://td/operator/operator/ann serial 0a); the reason: smoke "
                        "\\x1b[2J\n"));
  transition.set_cause("adopted");
  transition.clear_reason();
  EXPECT_EQ(NoEvidenceText(OfTransition(transition)),
            "no rule did it, but RIPS itself: an actuator held another level than this server had "
            "decided, and the more restrictive one was taken");
  v1::ExplainResponse with = OfTransition(transition);
  *with.mutable_evidence() = MakeEvidence();
  EXPECT_EQ(NoEvidenceText(with), "");
}

TEST(ExplainTextTest, IndentsByDepthAndAlignsValues) {
  v1::ExplainResponse recorded = OfTransition(MakeTransition());
  v1::Evidence* evidence = recorded.mutable_evidence();
  evidence->set_condition("a and (b or c)");
  evidence->set_cut(true);
  AddValue(evidence, 0, 14, 0, "true");
  AddValue(evidence, 0, 1, 1, "true");
  AddValue(evidence, 6, 8, 1, "true");
  AddValue(evidence, 7, 1, 2, "false: there are 3");
  AddValue(evidence, 12, 1, kHuge, "true");
  const std::string text = Print({.recorded = recorded});
  EXPECT_THAT(text, HasSubstr("  its values at that time:\n"
                              "    a and (b or c)     true\n"
                              "      a                true\n"
                              "      (b or c)         true\n"
                              "        b              false: there are 3\n"
                              "                    c  true\n"));
  EXPECT_THAT(text, HasSubstr("  there were more values or subjects than are kept\n"));
  EXPECT_THAT(text, Not(HasSubstr("the event:")));
}

TEST(ExplainTextTest, HostileTextCannotLeaveItsPlace) {
  v1::ExplainResponse recorded = OfTransition(MakeTransition());
  const std::string evil = "\x1b[2J\r\nNow: r1 is at DEFAULT \xe2\x80\xae";
  recorded.mutable_transition()->set_cause("rule " + evil);
  recorded.mutable_transition()->set_detail(evil);
  recorded.mutable_transition()->set_stage(evil);
  v1::Evidence* evidence = recorded.mutable_evidence();
  *evidence = MakeEvidence();
  evidence->set_place(evil);
  evidence->set_event(evil);
  evidence->set_condition("a \"" + evil + "\"");
  AddValue(evidence, 2, kHuge, 1, evil);
  evidence->mutable_subjects(0)->set_name(evil);
  evidence->mutable_subjects(0)->set_host(evil);
  *recorded.add_alerts() = MakeAlert(evil);
  v1::GetLevelResponse now = At("COMPROMISED");
  now.mutable_status()->set_stage(evil);
  now.mutable_status()->set_effective_level(evil);
  v1::LevelResponse found;
  found.add_would_raise_again(evil);
  found.add_blind_because(evil);
  const std::string text =
      Print({.recorded = recorded, .now = now, .lowering = Lowering{evil, found}});
  EXPECT_EQ(text.find_first_of("\x1b\r"), std::string::npos);
  EXPECT_THAT(text, Not(HasSubstr("\xe2\x80\xae")));
  EXPECT_THAT(text, Not(HasSubstr("\nNow: r1 is at DEFAULT")));
}

TEST(ExplainTextTest, SaysWhatIsNow) {
  v1::ExplainResponse recorded = OfTransition(MakeTransition());
  v1::GetLevelResponse now = At("DEFAULT");
  now.mutable_status()->set_stage("failed");
  now.mutable_status()->clear_effective_level();
  EXPECT_THAT(
      Print({.recorded = recorded, .now = now}),
      HasSubstr(
          "Now: r1 is at DEFAULT (decision 3.17), failed: an actuator cannot reach the level; "
          "it tries again\n  no actuator is attached\n"));
  v1::HostFirewall& firewall = *now.add_firewalls();
  firewall.set_host("base");
  firewall.set_counted_s(300);
  EXPECT_THAT(Print({.recorded = recorded, .now = now}),
              HasSubstr("\n  the firewall of base says that it dropped no packet in 300 s\n"));
  v1::FirewallSource& source = *firewall.add_sources();
  source.set_address("10.0.0.66");
  source.set_packets(7);
  source.set_quiet_s(60);
  EXPECT_THAT(Print({.recorded = recorded, .now = now}),
              HasSubstr(" in 300 s; by address, which may be forged:\n"
                        "    from 10.0.0.66: 7 packets, none in the last 60 s\n"));
  *recorded.mutable_evidence() = MakeEvidence();
  EXPECT_THAT(Print({.recorded = recorded, .now = now}),
              HasSubstr("    from 10.0.0.66 (which /intruder gave as its own; no agent of RIPS is "
                        "there): 7 packets, none in the last 60 s\n"));
  recorded.clear_evidence();
  EXPECT_THAT(Print({.recorded = recorded, .now = absl::NotFoundError("no robot `r1`")}),
              HasSubstr("Now: not known: no robot `r1`\n"));
  EXPECT_THAT(Print({.recorded = recorded, .now = At("COMPROMISED")}), Not(HasSubstr("  rules ")))
      << "the server does not say";
  now = At("COMPROMISED");
  now.set_rules_cannot_lower_because("evidence has been complete for only 0.1 s\n");
  EXPECT_THAT(Print({.recorded = recorded, .now = now}),
              HasSubstr("\n  rules cannot lower it now: evidence has been complete for only 0.1 "
                        "s\\x0a\n"));
  now.set_rules_cannot_lower_because("");
  EXPECT_THAT(Print({.recorded = recorded, .now = now}),
              HasSubstr("\n  rules may lower it when their conditions hold\n"));
  v1::LoweringRule* calm = now.add_lowering_rules();
  calm->set_rule("calm");
  calm->set_holds(false);
  calm->mutable_evidence()->set_place("warehouse.rul:40");
  calm->mutable_evidence()->set_condition("CurrLevel == ALERT && alone");
  AddValue(calm->mutable_evidence(), 0, 18, 0, "true");
  AddValue(calm->mutable_evidence(), 22, 5, 0, "false");
  v1::LoweringRule* told = now.add_lowering_rules();
  told->set_rule("told\x1b[2J");
  told->mutable_evidence()->set_condition("topicin(\"/calm\")");
  EXPECT_THAT(Print({.recorded = recorded, .now = now}),
              HasSubstr("\n  rules may lower it when their conditions hold\n"
                        "    rule calm, warehouse.rul:40: false now\n"
                        "      CurrLevel == ALERT  true\n"
                        "      alone               false\n"
                        "    rule told\\x1b[2J: judges messages\n"
                        "      topicin(\"/calm\")\n"));
  const auto with = [&](absl::StatusOr<v1::LevelResponse> found) {
    return Print({.recorded = recorded,
                  .now = At("COMPROMISED"),
                  .lowering = Lowering{"ALERT", std::move(found)}});
  };
  EXPECT_THAT(with(absl::PermissionDeniedError("vera is a viewer")),
              HasSubstr("  what would raise it again: to ask that needs an operator's "
                        "certificate\n"));
  EXPECT_THAT(with(absl::FailedPreconditionError("the store is full")),
              HasSubstr("  what would raise it again is not known: the store is full\n"));
  EXPECT_THAT(with(v1::LevelResponse()),
              HasSubstr("now, it\n    would not be raised again at once: no rule on the graph or a "
                        "tick would fire\n"));
  v1::LevelResponse blind;
  blind.add_blind_because("sensor base lost");
  EXPECT_THAT(with(blind), HasSubstr("  if it were lowered to ALERT now, it\n"
                                     "    blind: sensor base lost\n"
                                     "    would be refused, because RIPS does not see all of r1 "
                                     "now; --accept-blind lowers it all the same\n"));
  EXPECT_THAT(Print({.now = At("DEFAULT")}),
              StartsWith("nothing was ever decided for r1: it is where it began\n"));
}

TEST(ExplainTextTest, LongConditionsAreCut) {
  v1::ExplainResponse recorded = OfTransition(MakeTransition());
  std::string condition = "any";
  for (int i = 0; i < 40; ++i) absl::StrAppend(&condition, "\r\n\tline", i);
  recorded.mutable_evidence()->set_condition(condition);
  const std::string text = Print({.recorded = recorded});
  EXPECT_THAT(text, HasSubstr("    any\n      line0\n      line1\n"));
  EXPECT_THAT(text,
              AllOf(HasSubstr("      line18\n    (21 more lines)\n"), Not(HasSubstr("line19"))));
  recorded.mutable_evidence()->set_condition(std::string(10'000, 'x'));
  EXPECT_THAT(Print({.recorded = recorded}), HasSubstr("\n    " + std::string(157, 'x') + "...\n"));
}

TEST(PieceTextTest, NeverTrustsItsPlace) {
  EXPECT_EQ(PieceText("a and b", 6, 1, 56), "b");
  EXPECT_EQ(PieceText("a and b", 6, kHuge, 56), "b...") << "the condition was cut";
  EXPECT_EQ(PieceText("a and b", 7, 1, 56), "...");
  EXPECT_EQ(PieceText("a and b", kHuge, kHuge, 56), "...");
  EXPECT_EQ(PieceText("", 0, 0, 56), "...");
  EXPECT_EQ(PieceText("a", 0, 0, 56), "");
  EXPECT_EQ(PieceText("ñ", 1, 1, 56), "\\xb1") << "half of a character";
}

TEST(PieceTextTest, IsOneShortLine) {
  EXPECT_EQ(PieceText("a\r\n\t and  # why \"\n  b", 0, 21, 56), "a and b");
  EXPECT_EQ(PieceText("x(\"a  # \\\"b\")", 0, 13, 56), "x(\"a  # \\\"b\")");
  EXPECT_EQ(PieceText("a # no end", 0, 10, 56), "a");
  EXPECT_EQ(PieceText("0123456789", 0, 10, 10), "0123456789");
  EXPECT_EQ(PieceText("0123456789a", 0, 11, 10), "0123456...");
  EXPECT_EQ(PieceText("ññññññ", 0, 12, 5), "ññ...");
}

}  // namespace
}  // namespace rips::ripsctl
